"""Compares the output of independent programs, which read the descriptions of the link, with that of `solaspect link decode`.

    check_descriptions.py PROGRAM KAITAI XTCE XTCE_CCSDS PACKETS WORK

KAITAI is the folder of the module that Kaitai's compiler made, PACKETS a file with packets in hexadecimal at the ends of its lines, WORK
a folder for a flight of some seconds. The bytes are those packets, those of that flight over UDP, every command of the XTCE, encoded by it alone, and
the space packets of that flight's output.
"""

import math
import re
import socket
import struct
import subprocess
import sys
import time
import warnings
from datetime import datetime
from pathlib import Path

import lxml.etree as etree
import space_packet_parser as spp
from kaitaistruct import BytesIO, KaitaiStream
from space_packet_parser.xtce.definitions import XtcePacketDefinition
from space_packet_parser.xtce.validation import validate_xtce

warnings.simplefilter("error")
PROGRAM, KAITAI, XTCE, XTCE_CCSDS, PACKETS, WORK = sys.argv[1:]
# Number of the newest layout of housekeeping.
LAYOUTS = max(map(int, re.findall(r'"Housekeeping(\d+)"', Path(XTCE).read_text())))
sys.path.insert(0, KAITAI)
from solaspect_link import SolaspectLink  # noqa: E402

NS = {"x": "http://www.omg.org/spec/XTCE/20180204"}
LOG_PORT, FLIGHT_PORT, OUTPUT_PORT = 47120, 47121, 47122
counts = {}


def check(what, found, expected, tolerance=0.0):
    counts[what] = counts.get(what, 0) + 1
    both_nan = isinstance(found, float) and isinstance(expected, float) and math.isnan(found) and math.isnan(expected)
    near = tolerance and abs(found - expected) <= tolerance
    if not (found == expected or both_nan or near):
        sys.exit(f"{what}: expected {expected!r}, found {found!r}")


def decode(source, data):
    """The program's lines for each packet in the bytes."""
    path = Path(WORK, "bytes.bin")
    path.write_text(data.hex())
    run = subprocess.run([PROGRAM, "link", "decode", "--from", source, path], capture_output=True, text=True, check=True)
    *lines, total = run.stdout.splitlines()
    assert total.endswith("rejected: 0 packets, 0 bytes"), total
    packets = []
    for line in lines:
        if line.startswith("  "):
            packets[-1].append(line.strip())
        else:
            packets.append([line])
    return packets


class Commands:
    """Encodes commands as the XTCE describes them."""

    def __init__(self, path):
        root = etree.parse(path).getroot()
        self.commands = {c.get("name"): c for c in root.iterfind(".//x:MetaCommand", NS)}
        self.types = {t.get("name"): t for t in root.find(".//x:ArgumentTypeSet", NS)}
        self.sequence = 0

    def names(self):
        return [name for name, command in self.commands.items() if command.get("abstract") != "true"]

    def chain(self, name):
        command = self.commands[name]
        base = command.find("x:BaseMetaCommand", NS)
        return [*(self.chain(base.get("metaCommandRef")) if base is not None else []), command]

    def arguments(self, name):
        """The command's own arguments with their types."""
        own = self.commands[name].iterfind("x:ArgumentList/x:Argument", NS)
        return {a.get("name"): self.types[a.get("argumentTypeRef")] for a in own}

    def samples(self, name):
        """Two values for every argument: the ends of its range, if it has one."""
        def of(kind):
            valid = kind.find(".//x:ValidRange", NS)
            if kind.tag.endswith("BooleanArgumentType"):
                return "on", "off"
            if valid is not None:
                number = float if "." in valid.get("maxInclusive") else int
                return tuple(number(valid.get(end)) for end in ("minInclusive", "maxInclusive"))
            return 34.5, -104.25
        kinds = self.arguments(name)
        return [{argument: of(kind)[at] for argument, kind in kinds.items()} for at in (0, 1)]

    def encode(self, name, values, computers="computer_1"):
        self.sequence += 1
        values = {**values, "sequence": self.sequence, "computers": computers, "checksum": 0}
        bits = ""
        chain = self.chain(name)
        for command in chain:
            for assigned in command.iterfind(".//x:ArgumentAssignment", NS):
                values[assigned.get("argumentName")] = int(assigned.get("argumentValue"))
        kinds = {k: v for command in chain for k, v in self.arguments(command.get("name")).items()}
        for command in chain:
            for entry in command.find("x:CommandContainer/x:EntryList", NS):
                if entry.tag.endswith("FixedValueEntry"):
                    size = int(entry.get("sizeInBits"))
                    bits += f"{int(entry.get('binaryValue'), 16):0{size}b}"[-size:]
                else:
                    argument = entry.get("argumentRef")
                    bits += self.bits(kinds[argument], values[argument])
        data = bytearray(int(bits, 2).to_bytes(len(bits) // 8, "big"))
        data[6:8] = self.crc(data).to_bytes(2, "big")
        return bytes(data)

    def bits(self, kind, value):
        encoding = kind.find(".//x:IntegerDataEncoding", NS)
        if encoding is None:
            encoding = kind.find(".//x:FloatDataEncoding", NS)
            return bits_of(struct.pack("<f" if encoding.get("sizeInBits") == "32" else "<d", value))
        for row in kind.iterfind(".//x:Enumeration", NS):
            if row.get("label") == value:
                value = int(row.get("value"))
        if kind.tag.endswith("BooleanArgumentType"):
            value = {kind.get("oneStringValue"): 1, kind.get("zeroStringValue"): 0}[value]
        terms = {t.get("exponent"): float(t.get("coefficient")) for t in kind.iterfind(".//x:Term", NS)}
        if terms:
            value = round((value - terms["0"]) / terms["1"])
        size = int(encoding.get("sizeInBits"))
        if size % 8:
            return f"{value:0{size}b}"
        order = "little" if encoding.get("byteOrder") == "leastSignificantByteFirst" else "big"
        return bits_of(value.to_bytes(size // 8, order, signed=encoding.get("encoding") == "twosComplement"))

    def crc(self, data):
        """The checksum by the parameters in the XTCE, with both reflections."""
        crc = self.types["checksum"].find(".//x:CRC", NS)
        text = lambda name: int(crc.find(f"x:{name}", NS).text, 16)
        polynomial = int(f"{text('Polynomial'):016b}"[::-1], 2)
        value = text("InitRemainder")
        for byte in data:
            value ^= byte
            for _ in range(8):
                value = value >> 1 ^ (polynomial if value & 1 else 0)
        return value ^ text("FinalXOR")


def bits_of(data):
    return "".join(f"{byte:08b}" for byte in data)


def sealed(commands, data):
    """A packet with a valid checksum."""
    data = bytearray(data)
    data[6:8] = b"\0\0"
    data[6:8] = commands.crc(data).to_bytes(2, "big")
    return bytes(data)


def fly(commands):
    """The bytes of a commanded flight on the line and in space packets; the commands include every read of the table."""
    log = Path(WORK, "flight.log")
    port = f"udp:127.0.0.1:{FLIGHT_PORT}@{LOG_PORT}"
    record = subprocess.Popen([PROGRAM, "link", "log", "--port", port, "--out", log, "--duration", "14s"])
    config = Path(WORK, "flight.toml")
    config.write_text(f'[[output]]\nto = "udp:127.0.0.1:{OUTPUT_PORT}"\nformat = "ccsds"\n')
    reader = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    reader.bind(("127.0.0.1", OUTPUT_PORT))
    reader.setblocking(False)
    flight = subprocess.Popen(
        [PROGRAM, "fly", "--config", config, "--camera", "simulated", "--serial", f"udp:127.0.0.1:{LOG_PORT}@{FLIGHT_PORT}", "--archive", Path(WORK, "archive"),
         "--duration", "12s"], stderr=subprocess.DEVNULL)
    time.sleep(2)
    reads = [name for name in commands.names() if name.startswith("get_")]
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for name in ["start_tracking", "gps", "moon", "send_pitch_yaw_picture", "set_target", *reads]:
        values = {"x": -300, "y": 450, "latitude_deg": 34.5, "longitude_deg": -104.25, "height_m": 38000.0, "disk": 1, "parameter": 1}
        values = {argument: values[argument] for argument in commands.arguments(name)}
        line.sendto(commands.encode(name, values), ("127.0.0.1", FLIGHT_PORT))
        time.sleep(0.05)
    line.close()
    space_packets = []
    while flight.poll() is None:
        try:
            space_packets.append(reader.recv(65536))
        except BlockingIOError:
            time.sleep(0.001)
    reader.close()
    assert flight.wait() == 0 and record.wait() == 0
    rows = log.read_text().splitlines()
    return b"".join(bytes.fromhex(row.split()[1]) for row in rows if row[0] != "#"), space_packets


def check_space_packets(commands, definition, flight, space_packets):
    """Compares each space packet by its XTCE with the same packet of the line by the line's XTCE, which was compared with the program."""
    described = XtcePacketDefinition.from_xtce(XTCE_CCSDS)
    kinds = {}
    path = Path(WORK, "telemetry.bin")
    path.write_bytes(b"".join(space_packets))
    with path.open("rb") as recorded:
        read_packets = [(data, described.parse_bytes(data)) for data in spp.ccsds_generator(recorded)]
    check("ccsds: packets", len(read_packets), len(space_packets))
    for data, read in read_packets:
        kind = read["packet_type"]
        check("ccsds: header", [read[f"packet_{n}"] for n in ("version", "is_command", "has_secondary_header", "sequence_flags")], [0, 0, 1, 3])
        check("ccsds: sequence count", read["packet_sequence_count"], kinds.get(kind, 0) % 16384)
        kinds[kind] = kinds.get(kind, 0) + 1
        check("ccsds: time code", read["time_code"], 0x41)
        payload = bytes(data)[15:]
        check("ccsds: length", read["packet_data_length"] + 1, 9 + len(payload))
        head = b"\x9a\xc3" + bytes([kind, 0x30]) + len(payload).to_bytes(2, "little") + b"\0\0"
        ms = (read["time_days"] - 4383) * 86_400_000 + read["time_milliseconds"]
        nanoseconds = ms % 1000 * 1_000_000 + read["time_microseconds"] * 1000
        packet = sealed(commands, head + struct.pack("<II", nanoseconds, ms // 1000) + payload)
        own = definition.parse_bytes(packet, root_container_name="TelemetryPacket")
        shared = [name for name in own if name in read and not name.startswith("packet_")]
        check("ccsds: payload is described", bool(shared) or not payload, True)
        for name in shared:
            check("ccsds: field", bytes(read[name]) if isinstance(read[name], bytes) else read[name], own[name])
        # A packet on the line has the same payload and seconds.
        check("ccsds: is on the line", packet[12:] in flight, True)
    check("ccsds: kinds", {0x01, 0x70, 0x82, 0x83, 0xE1} <= set(kinds), True)


def seconds(text):
    whole, _, fraction = text.rstrip("Z").partition(".")
    return datetime.fromisoformat(whole + "+00:00").timestamp() + float(f"0.{fraction or 0}")


NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"
TEMPLATES = {
    "Solution": rf"solution azimuth {NUMBER} elevation {NUMBER} roll {NUMBER} error {NUMBER} deg at (\S+Z)",
    "Propagated": rf"by gyros azimuth {NUMBER} elevation {NUMBER} roll {NUMBER} error {NUMBER} deg at (\S+Z), {NUMBER} ms after a frame",
    "Error": rf"no solution, error {NUMBER}",
    "ExposureStart": rf"exposure of camera {NUMBER} at (\S+Z)",
    "Gps": rf"GPS latitude {NUMBER} longitude {NUMBER} deg",
    "Moon": rf"where is the Moon from latitude {NUMBER} longitude {NUMBER} deg height {NUMBER} m",
    "MoonFound": rf"Moon of seq {NUMBER}: found at {NUMBER} {NUMBER} px, towards \[{NUMBER}, {NUMBER}, {NUMBER}\], at (\S+Z)",
    "MoonNotVisible": rf"Moon of seq {NUMBER}: not visible \({NUMBER}\)",
    "MoonNotFound": rf"Moon of seq {NUMBER}: not found \({NUMBER}\)",
    "ImuSample": rf"IMU sample {NUMBER}: force \[{NUMBER}, {NUMBER}, {NUMBER}\] m/s\^2, rate \[{NUMBER}, {NUMBER}, {NUMBER}\] rad/s",
    "PictureSection": rf"picture of camera {NUMBER}, {NUMBER} x {NUMBER} px: {NUMBER} pixels from {NUMBER}",
    "Receipt": rf"receipt of seq {NUMBER}",
    "PictureTag": r"picture tag (\S+)",
}
PLAIN = {"covariance_xx_px2", "covariance_xy_px2", "covariance_yy_px2"}


def numbers(body):
    """The numbers of a body in the order in which the program prints them; seconds and milliseconds form one time."""
    if type(body).__name__ == "PictureSection":
        return [body.camera, body.width, body.height, len(body.pixels), body.first_pixel]
    if type(body).__name__ == "PictureTag":
        return [body.name]
    stated = {name: value for name, value in vars(body).items() if name[0] != "_" and name not in PLAIN}
    if "milliseconds" in stated:
        stated["seconds"] += stated.pop("milliseconds") / 1000
    return [int(value) if isinstance(value, int) else value for value in stated.values()]


def check_words(body, words):
    """Compares a body read by Kaitai with the program's text for the same bytes."""
    name = type(body).__name__
    if name == "Housekeeping":
        return check_housekeeping(body, words)
    if name == "Result":
        return check_result(body, words[0])
    if name == "AspectCommand":
        return check_command(body, words[0])
    match = re.search(TEMPLATES[name], words[0]) if name in TEMPLATES else None
    if match is None:
        return check("ksy: nothing to compare", name, "Nothing")
    for found, stated in zip(numbers(body), match.groups(), strict=True):
        if stated.endswith("Z"):
            check(f"ksy: {name}", found, seconds(stated), 1e-6)
        elif name == "PictureTag":
            check(f"ksy: {name}", found, stated)
        else:
            single = name in ("Gps", "ImuSample") and isinstance(found, float)
            check(f"ksy: {name}", found, single_precision(stated) if single else float(stated))
    if name == "PictureSection":
        check("ksy: last section", body.is_last, words[0].endswith(", the last"))


def single_precision(number):
    return struct.unpack("<f", struct.pack("<f", float(number)))[0]


def check_result(body, words):
    sequence, key, said = re.search(r"result of seq (\d+), .*\((0x[0-9a-f]+)\): (.*)", words).groups()
    check("ksy: Result", [body.sequence, body.key], [int(sequence), int(key, 16)])
    stated = {"done": 0, "not implemented": 1, "refused: out of range": 2, "unknown": 65535, "not known": 65535}
    if said in stated:
        return check("ksy: Result", body.value, stated[said])
    number = float(said.split()[1])
    check("ksy: value of a read", number in (body.value, body.signed, body.angle), True)


def check_command(body, words):
    """Compares name, key and variables of a command."""
    name, key, rest = re.search(r"(\w+) \((0x[0-9a-f]+)\)(.*)", words).groups()
    check("ksy: command", [body.command.name, body.key], [name, int(key, 16)])
    for variable, number in re.findall(rf"(\w+) {NUMBER}", rest):
        check("ksy: variable of a command", getattr(body.variables, variable), float(number))


def of_housekeeping(words):
    """Yields fields and values from the program's lines."""
    names = {"Some": lambda value: value, "MarkIds": lambda value: value, "true": 1, "false": 0, "unknown": 0}
    for line in words[1:]:
        name, value = re.match(r"(\w+) ([\w.]+\(.*\)|\[.*\]|\S+)", line).groups()
        if name in ("commit", "configuration"):
            yield name, 0 if value == "unknown" else int(value, 16)
        else:
            yield name, eval(value, {"__builtins__": {}}, names)


def same_field(what, name, found, stated):
    """Compares a field's encoded value with the printed one."""
    if name == "ids":
        stated = [0 if mark is None else 16 * (mark[0] + 8) + mark[1] + 8 for mark in stated]
    elif name in ("disk_1", "disk_2", "night"):
        stated = 255 if stated is None else stated
    elif isinstance(found, float):
        stated = math.nan if stated is None else single_precision(stated)
    check(what, found, stated)


def check_housekeeping(body, words):
    for name, stated in of_housekeeping(words):
        if hasattr(body, name):
            found = getattr(body, name)
            same_field("ksy: field of housekeeping", name, int(found) if isinstance(found, int) else found, stated)
        else:
            check("ksy: field absent", body.layout < LAYOUTS, True)
    check("ksy: rest of housekeeping", body.rest, b"")


def check_xtce(definition, packet, body, words):
    """Compares a packet read by space-packet-parser with the program's numbers (housekeeping) or with Kaitai's (others)."""
    root = "TelemetryPacket" if isinstance(packet.body, SolaspectLink.Telemetry) else "CommandPacket"
    read = definition.parse_bytes(packet.data, root_container_name=root)
    head = packet.body
    if root == "TelemetryPacket":
        found = [read[name] for name in ("packet_type", "packet_source", "payload_length", "checksum", "nanoseconds", "seconds")]
        check("xtce: header", found, [head.kind, head.source, head.len_payload, head.checksum, head.nanoseconds, head.seconds])
    else:
        found = [read[name] for name in ("packet_target", "command_payload_length", "packet_sequence", "checksum", "message_key")]
        check("xtce: header", found, [head.target, head.len_payload, head.sequence, head.checksum, head.payload.messages[0].key])
    name = type(body).__name__
    if name == "Housekeeping":
        for field, stated in of_housekeeping(words):
            names = [f"{field}_{n + 1}" for n in range(len(stated))] if isinstance(stated, list) else [field]
            if names[0] not in read:
                check("xtce: field absent", body.layout < LAYOUTS, True)
                continue
            values = [read[n].raw_value for n in names]
            same_field("xtce: field of housekeeping", field, values if isinstance(stated, list) else values[0], stated)
        return
    if name == "PictureSection":
        width = 16 * read["section_width_high"] + read["section_width_low"]
        height = 256 * read["section_height_high"] + read["section_height_low"]
        found = [read["section_camera"], width, height, len(read["section_pixels"]), read["section_first_pixel"]]
        check("xtce: PictureSection", found, numbers(body))
        return check("xtce: pixels", (bytes(read["section_pixels"]), bool(read["section_is_last"])), (body.pixels, body.is_last))
    if name == "PictureTag":
        found = [bytes(read["tag_value"]), read["tag_type"], read["tag_name"].rstrip("\0"), read["tag_comment"].rstrip("\0")]
        return check("xtce: PictureTag", found, [body.value_bytes, body.tag_type, body.name, body.comment])
    prefix = re.sub(r"(?<=.)([A-Z])", r"_\1", name).lower()
    prefix = prefix if root == "TelemetryPacket" else f"message_{prefix}"
    for field, value in vars(body).items():
        if field[0] != "_":
            check(f"xtce: {name}", read[f"{prefix}_{field}"].raw_value, value)


def check_stream(source, data, definition):
    """Compares all packets of a stream as read by Kaitai, by the program and, if the XTCE has them, by space-packet-parser."""
    stream = KaitaiStream(BytesIO(data))
    packets = (SolaspectLink if source == "aspect" else SolaspectLink.ToAspect)(stream).packets
    said = decode(source, data)
    check("packets", len(packets), len(said))
    at = 0
    for packet, words in zip(packets, said):
        command = isinstance(packet.body, SolaspectLink.Command)
        length = (8 if command else 16) + packet.body.len_payload
        packet.data, at = data[at:at + length], at + length
        bodies = [message.body for message in packet.body.payload.messages] if command else [getattr(packet.body, "payload", None)]
        for body, part in zip(bodies, words[0].split("; ") if len(bodies) > 1 else [words[0]]):
            check_words(body, [part, *words[1:]])
        if len(bodies) == 1 and (not command or source == "aspect"):
            check_xtce(definition, packet, bodies[0], words)
    check("bytes", at, len(data))


def earlier_layouts(commands, data, definition):
    """Housekeeping truncated to each layout, with the lengths of the XTCE's containers."""
    packet = next(data[m.start():] for m in re.finditer(b"\x9a\xc3\x70\x30", data))
    payload = packet[16:16 + int.from_bytes(packet[4:6], "little")]
    length, packets = 1, []
    for layout in range(1, LAYOUTS + 1):
        entries = definition.containers[f"Housekeeping{layout}"].entry_list
        length += sum(entry.parameter_type.encoding.size_in_bits for entry in entries) // 8
        cut = bytes([layout]) + payload[1:length]
        packets.append(sealed(commands, packet[:4] + len(cut).to_bytes(2, "little") + packet[6:16] + cut))
    check("length of the last layout", length, len(payload))
    return b"".join(packets)


def main():
    for path in (XTCE, XTCE_CCSDS):
        check("xtce: errors by the schema", validate_xtce(path, level="schema", print_results=False, allow_schema_download=False).errors, [])
    definition = XtcePacketDefinition.from_xtce(XTCE)
    commands = Commands(XTCE)
    rows = re.findall(r"[ `](9ac3[0-9a-f]+)`?(?: \|)?$", Path(PACKETS).read_text(), re.M)
    rows += re.findall(r" (9ac3[0-9a-f]+)$", Path("tests/data/packets.txt").read_text(), re.M)
    packets = [bytes.fromhex(row) for row in rows]
    to_aspect = [packet for packet in packets if packet[2] == 0x30]
    from_aspect = [packet for packet in packets if packet[2] != 0x30]
    for name in commands.names():
        to_aspect += [commands.encode(name, values, computers) for values in commands.samples(name) for computers in ("computer_1", "both")]
    imu = b"\x9a\xc3\x71\x01\x1a\x00\0\0" + struct.pack("<IIH6f", 250_000_000, 1_379_786_400, 65535, 0.1, -0.2, -9.7, 1e-5, -7e-5, 4e-3)
    parts = [("set_target", {"x": 1, "y": 2}), ("start_tracking", {}), ("gps", {"latitude_deg": 34.5, "longitude_deg": -104.25})]
    payload = b"".join(commands.encode(name, values)[8:] for name, values in parts)
    several = b"\x9a\xc3\x30" + bytes([len(payload), 7, 0, 0, 0]) + payload
    to_aspect += [sealed(commands, imu), sealed(commands, several)]
    check_stream("controller", b"".join(to_aspect), definition)
    check_stream("aspect", b"".join(from_aspect), definition)
    flight, space_packets = fly(commands)
    check_stream("aspect", flight, definition)
    check_space_packets(commands, definition, flight, space_packets)
    last = struct.pack("<II", 100 << 8 | 1, 13 << 20 | 17 << 8 | 6 << 4 | 3 << 1) + bytes(range(121))
    last = b"\x9a\xc3\x82\x30" + len(last).to_bytes(2, "little") + bytes(10) + last
    propagated = struct.pack("<HddddIHH", 0x1105, 0.0125, -0.0034, -1.5, 2e-5, 1_379_786_400, 250, 1250)
    propagated = b"\x9a\xc3\x01" + bytes([len(propagated), 8, 0, 0, 0]) + propagated
    idle = b"\x9a\xc3\x03\x30" + bytes(12)
    crafted = earlier_layouts(commands, flight, definition) + b"".join(sealed(commands, packet) for packet in (last, propagated, idle))
    check_stream("aspect", crafted, definition)
    for what, count in counts.items():
        print(f"{count:8} {what}")


main()
