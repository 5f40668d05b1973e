meta:
  id: solaspect_link
  title: "Controller link of solaspect"
  ks-version: "0.11"
  endian: le
  bit-endian: le
doc: "The controller link of solaspect, made by `solaspect link describe --format ksy`. The top level reads a stream of packets of the aspect system, to the controller and the ground; the type to_aspect reads one of packets to the aspect system. Checksums are read and not checked, for Kaitai Struct has no CRC. What is cut short is an error of the reader."
seq:
  - {id: packets, type: packet_from_aspect, repeat: eos}
types:
  to_aspect: {doc: "A stream of packets to the aspect system.", seq: [{id: packets, type: packet_to_aspect, repeat: eos}]}
  packet_from_aspect:
    seq:
      - {id: sync, contents: [154, 195]}
      - {id: first, type: u1, doc: "type of telemetry, or target of a command packet"}
      - {id: second, type: u1, doc: "source of telemetry, or payload length of a command packet"}
      - {id: body, type: {switch-on: is_telemetry, cases: {"true": "telemetry(first, second)", "false": "command(first, second)"}}}
    instances: {is_telemetry: {value: "@from_aspect@"}}
  packet_to_aspect:
    seq:
      - {id: sync, contents: [154, 195]}
      - {id: first, type: u1, doc: "type of telemetry, or target of a command packet"}
      - {id: second, type: u1, doc: "source of telemetry, or payload length of a command packet"}
      - {id: body, type: {switch-on: is_telemetry, cases: {"true": "telemetry(first, second)", "false": "command(first, second)"}}}
    instances: {is_telemetry: {value: "@to_aspect@"}}
  telemetry:
    params: [{id: kind_code, type: u1}, {id: source_code, type: u1}]
    seq:
      - {id: len_payload, type: u2}
      - {id: checksum, type: u2be, doc: "CRC-16/MODBUS over the whole packet with these two bytes zero; stored high byte first"}
      - {id: nanoseconds, type: u4, doc: "of the packet's time", -unit: ns}
      - {id: seconds, type: u4, doc: "the packet's time, UTC since 1970", -unit: s}
      - id: payload
        size: len_payload
        type:
          switch-on: kind
          cases:
@telemetry_cases@
    instances:
      kind: {value: kind_code, enum: telemetry_type}
      source: {value: source_code, enum: party}
  command:
    params: [{id: target_code, type: u1}, {id: len_payload, type: u1}]
    seq:
      - {id: sequence, type: u2, doc: "the sender's number of the packet"}
      - {id: checksum, type: u2be, doc: "CRC-16/MODBUS over the whole packet with these two bytes zero; stored high byte first"}
      - {id: payload, type: messages, size: len_payload}
    instances: {target: {value: target_code, enum: party}}
  messages:
    doc: "Messages, one after the other. A key that is zero or not known ends them: its message holds the rest."
    seq:
      - {id: messages, type: message, repeat: until, repeat-until: "_io.size - _io.pos < 2", if: "_io.size >= 2"}
      - {id: rest, size-eos: true, doc: "a single byte at the end is none of a message"}
  message:
    seq:
      - {id: key, type: u2, enum: message_key}
      - id: body
        type:
          switch-on: key
          cases:
@message_cases@
            "_": rest
  aspect_command:
    doc: "A command of the ground."
    seq:
      - {id: key, type: u2, doc: "with the bits of the computers"}
      - id: variables
        type:
          switch-on: command
          cases:
@command_cases@
            "_": "words(num_variables)"
    instances:
      command: {value: "key & 0x0fff", enum: command_name}
      for_computer_1: {value: "(key & 0x1000) != 0"}
      for_computer_2: {value: "(key & 0x2000) != 0"}
      num_variables: {value: "key & 0x000f"}
  words:
    doc: "Variables of a command that is not in the table."
    params: [{id: num_words, type: u1}]
    seq: [{id: words, type: u2, repeat: expr, repeat-expr: num_words}]
  nothing: {doc: "No fields."}
  rest: {doc: "A message whose key is not known, or zeros that pad the packet.", seq: [{id: bytes, size-eos: true}]}
  housekeeping:
    doc: "Status of the aspect system, each second. A field that the packet's layout does not have is absent."
    seq:
      - {id: layout, type: u1, doc: "@layout@: the layout of this description; earlier ones end sooner"}
@housekeeping@
      - {id: rest, size-eos: true, doc: "what a later layout has"}
    instances: {known_layout: {value: "layout <= @layout@ ? layout : 0", doc: "the layout; 0 for one that this description does not know"}}
  picture_section:
    doc: "A run of pixels of a picture."
    seq:
      - {id: is_last, type: b1, doc: "this is the last section"}
      - {id: reserved, type: b7}
      - {id: first_pixel, type: b24, doc: "number of its first pixel, row by row"}
      - {id: zero, type: b1}
      - {id: depth, type: b3, doc: "3: 8 bits a pixel"}
      - {id: camera, type: b4, doc: "1, 2: pitch-yaw; 6: roll; 7: Moon"}
      - {id: height, type: b12, -unit: px}
      - {id: width, type: b12, -unit: px}
      - {id: pixels, size-eos: true, doc: "8 bits each"}
  picture_tag:
    doc: "A keyword of a picture; its value is text, whole or number, by its type."
    seq:
      - {id: value_bytes, size: 16}
      - {id: tag_type, type: u1, enum: tag_type}
      - {id: camera, type: u1}
      - {id: name, type: str, size: 8, encoding: UTF-8, terminator: 0}
      - {id: comment, type: str, size: 32, encoding: UTF-8, terminator: 0}
    instances:
      text: {pos: 0, size: 16, type: str, encoding: UTF-8, terminator: 0, if: "tag_type == tag_type::text"}
      whole: {pos: 0, type: s4, if: "tag_type == tag_type::whole"}
      number: {pos: 0, type: f8, if: "tag_type == tag_type::number"}
@types@
enums:
@enums@
