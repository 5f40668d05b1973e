//! Types, parameters and containers of what the aspect system sends, and of samples of the IMU.

use super::types::{binary, camel, comparison, enumerated, integer, text, unix_seconds};
use super::{Role, checksum_type, number_type, unsigned_bits};
use crate::commands::schema::xml::Element;
use crate::link::housekeeping::{LAYOUT, fields_by_layout};
use crate::link::message::MESSAGES;
use crate::link::number::{Field, Number};
use crate::link::packet::{Direction, id, telemetry_type};
use crate::link::telemetry::{Payload, TELEMETRY, TelemetryRow};

const CAMERAS: &str = "1, 2: pitch-yaw; 6: roll; 7: Moon";
/// Bytes of a picture's section before its pixels.
const SECTION_HEADER: usize = 8;

pub fn meta_data() -> Element {
    let mut all = Definitions::default();
    all.header();
    for row in TELEMETRY {
        all.telemetry(row);
    }
    all.command_packet();
    for row in MESSAGES
        .iter()
        .filter(|row| row.direction == Direction::ToController)
    {
        let entries = all.fields(&format!("message_{}", row.name), &row.fields());
        let criteria = [comparison("message_key", "==", row.key)];
        all.container(
            &camel(row.name),
            row.documentation,
            entries,
            "CommandPacket",
            &criteria,
        );
    }
    let set = |name: &str, elements: Vec<Element>| Element::new(name).children(elements);
    Element::new("TelemetryMetaData")
        .child(set("ParameterTypeSet", all.types))
        .child(set("ParameterSet", all.parameters))
        .child(set("ContainerSet", all.containers))
}

#[derive(Default)]
struct Definitions {
    types: Vec<Element>,
    parameters: Vec<Element>,
    containers: Vec<Element>,
}

impl Definitions {
    /// Adds a parameter and its type; gives its entry in a container.
    fn parameter(&mut self, name: &str, kind: Element, documentation: &str) -> Element {
        let type_name = kind.attribute("name").unwrap_or_default().to_owned();
        if !self.types.contains(&kind) {
            self.types.push(kind);
        }
        let parameter = Element::new("Parameter")
            .with("parameterTypeRef", type_name)
            .with("name", name)
            .with_some("shortDescription", documentation);
        if !self.parameters.contains(&parameter) {
            self.parameters.push(parameter);
        }
        Element::new("ParameterRefEntry").with("parameterRef", name)
    }

    fn number(&mut self, name: &str, number: Number, unit: &str, documentation: &str) -> Element {
        self.parameter(
            name,
            number_type(Role::Parameter, number, unit),
            documentation,
        )
    }

    fn fields(&mut self, prefix: &str, fields: &[Field]) -> Vec<Element> {
        let fields = fields.iter().map(|field| {
            let name = format!("{prefix}_{}", field.name);
            self.number(&name, field.number, field.unit, field.documentation)
        });
        fields.collect()
    }

    /// Adds a container that extends another.
    fn container(
        &mut self,
        name: &str,
        documentation: &str,
        entries: Vec<Element>,
        base: &str,
        criteria: &[Element],
    ) {
        let list = Element::new("ComparisonList").children(criteria.iter().cloned());
        let base = Element::new("BaseContainer")
            .with("containerRef", base)
            .child(Element::new("RestrictionCriteria").child(list));
        self.containers.push(
            Element::new("SequenceContainer")
                .with("name", name)
                .with_some("shortDescription", documentation)
                .child(Element::new("EntryList").children(entries))
                .child(base),
        );
    }

    fn root(&mut self, name: &str, documentation: &str, entries: Vec<Element>) {
        self.containers.push(
            Element::new("SequenceContainer")
                .with("name", name)
                .with("abstract", true)
                .with("shortDescription", documentation)
                .child(Element::new("EntryList").children(entries)),
        );
    }

    fn header(&mut self) {
        let entries = vec![
            self.sync(),
            self.number("packet_type", Number::U8, "", "type of telemetry"),
            self.number(
                "packet_source",
                Number::U8,
                "",
                "1 controller, 48 aspect system",
            ),
            self.number("payload_length", Number::U16, "", "bytes after the header"),
            self.checksum(),
            self.number("nanoseconds", Number::U32, "ns", "of the packet's time"),
            self.parameter(
                "seconds",
                unix_seconds(),
                "the packet's time, UTC since 1970",
            ),
        ];
        self.root("TelemetryPacket", "A telemetry packet", entries);
    }

    fn command_packet(&mut self) {
        let entries = vec![
            self.sync(),
            self.number(
                "packet_target",
                Number::U8,
                "",
                "1 controller, 48 aspect system, 255 everyone",
            ),
            self.number(
                "command_payload_length",
                Number::U8,
                "",
                "bytes after the header",
            ),
            self.number(
                "packet_sequence",
                Number::U16,
                "",
                "the sender's number of the packet",
            ),
            self.checksum(),
            self.number("message_key", Number::U16, "", "key of the message"),
        ];
        self.root(
            "CommandPacket",
            "A command packet with one message to the controller",
            entries,
        );
    }

    fn sync(&mut self) -> Element {
        self.number("sync_word", Number::U16, "", "0xC39A")
    }

    fn checksum(&mut self) -> Element {
        self.parameter("checksum", checksum_type(Role::Parameter), "")
    }

    fn telemetry(&mut self, row: &TelemetryRow) {
        let entries = match row.payload {
            Payload::Fields(fields) => self.fields(row.name, &fields()),
            Payload::Housekeeping => {
                vec![self.number("layout", Number::U8, "", "number of the layout")]
            }
            Payload::PictureSection => self.picture_section(),
            Payload::PictureTag => self.picture_tag(),
        };
        let mut criteria = vec![comparison("packet_type", "==", row.kind.into())];
        if row.kind == telemetry_type::RECEIPT {
            criteria.push(comparison("packet_source", "==", id::ASPECT.into()));
        }
        let name = camel(row.name);
        self.container(
            &name,
            row.documentation,
            entries,
            "TelemetryPacket",
            &criteria,
        );
        if matches!(row.payload, Payload::Housekeeping) {
            (1..=LAYOUT).for_each(|layout| self.housekeeping(layout));
        }
    }

    /// What a layout adds to the one before it.
    fn housekeeping(&mut self, layout: u8) {
        let mut entries = Vec::new();
        for (_, field) in fields_by_layout().filter(|(since, _)| *since == layout) {
            let kind = match field.codes {
                Some(codes) => enumerated(codes),
                None => number_type(Role::Parameter, field.number, field.unit),
            };
            let names = (1..=field.count).map(|number| match field.count {
                1 => field.name.to_owned(),
                _ => format!("{}_{number}", field.name),
            });
            let entry = |name: String| self.parameter(&name, kind.clone(), &field.in_words());
            entries.extend(names.map(entry));
        }
        let (name, base) = match layout {
            1 => ("Housekeeping1".to_owned(), "Housekeeping".to_owned()),
            layout => (
                format!("Housekeeping{layout}"),
                format!("Housekeeping{}", layout - 1),
            ),
        };
        let criteria = [
            comparison("layout", ">=", layout.into()),
            comparison("layout", "<=", LAYOUT.into()),
        ];
        let documentation = format!("housekeeping of layout {layout} or later");
        self.container(&name, &documentation, entries, &base, &criteria);
    }

    /// The bits of two little-endian numbers of 32 bits, in the order of bytes.
    fn picture_section(&mut self) -> Vec<Element> {
        let first = unsigned_bits(24).with("byteOrder", "leastSignificantByteFirst");
        let first = integer("u24", first);
        let mut entries = vec![
            self.bits("section_reserved", 7, ""),
            self.bits("section_is_last", 1, "1: this is the last section"),
            self.parameter(
                "section_first_pixel",
                first,
                "number of its first pixel, row by row",
            ),
            self.bits("section_camera", 4, CAMERAS),
            self.bits("section_depth", 3, "3: 8 bits a pixel"),
            self.bits("section_zero", 1, ""),
            self.bits(
                "section_height_low",
                8,
                "px; height = 256 height_high + height_low",
            ),
            self.bits(
                "section_width_low",
                4,
                "px; width = 16 width_high + width_low",
            ),
            self.bits("section_height_high", 4, ""),
            self.bits("section_width_high", 8, ""),
        ];
        let length = Element::new("ParameterInstanceRef").with("parameterRef", "payload_length");
        let in_bits = Element::new("LinearAdjustment")
            .with("slope", 8)
            .with("intercept", -8 * SECTION_HEADER as i32);
        let size = Element::new("DynamicValue").child(length).child(in_bits);
        entries.push(self.parameter("section_pixels", binary("pixels", size), "8 bits each"));
        entries
    }

    fn bits(&mut self, name: &str, size: usize, documentation: &str) -> Element {
        let kind = integer(&format!("bits{size}"), unsigned_bits(size));
        self.parameter(name, kind, documentation)
    }

    fn picture_tag(&mut self) -> Vec<Element> {
        let value = binary("tag_value", Element::new("FixedValue").text(8 * 16));
        vec![
            self.parameter("tag_value", value, "little-endian; read by tag_type"),
            self.number("tag_type", Number::U8, "", "16 text, 41 i32, 82 f64"),
            self.number("tag_camera", Number::U8, "", CAMERAS),
            self.parameter("tag_name", text("text8", 8), "padded with zeros"),
            self.parameter("tag_comment", text("text32", 32), "padded with zeros"),
        ]
    }
}
