//! A telemetry packet as a CCSDS space packet (CCSDS 133.0-B-2):
//!
//! | bytes | what |
//! |---|---|
//! | 6 | primary header: telemetry, with a secondary header, unsegmented; the APID is the packet's type; each APID has a sequence count of its own |
//! | 9 | secondary header: the packet's time as CCSDS day-segmented code (CCSDS 301.0-B-4) with its P-field: days since 1958, ms of the day, us of the ms, UTC |
//! | rest | the packet's payload, as specified in `docs/protocol.md` |
//!
//! Numbers of the headers are big-endian, as in CCSDS; those of the payload are little-endian, as on the line.

use crate::link::TelemetryPacket;
use arbitrary_int::{u11, u14};
use spacepackets::time::UnixTime;
use spacepackets::time::cds::{CdsTime, SubmillisPrecision};
use spacepackets::{CcsdsPacketCreator, PacketType, SpHeader};
use std::collections::BTreeMap;

/// Sequence numbers of the next packets, by type.
#[derive(Debug, Default)]
pub(super) struct Sequences(BTreeMap<u8, u14>);

impl Sequences {
    pub fn next(&mut self, kind: u8) -> u14 {
        let next = self.0.entry(kind).or_insert(u14::new(0));
        let own = *next;
        *next = next.wrapping_add(u14::new(1));
        own
    }
}

/// The space packet; `None` for a payload or a time that does not fit, which no packet of this program has.
pub(super) fn space_packet(packet: &TelemetryPacket, sequence: u14) -> Option<Vec<u8>> {
    let (seconds, nanoseconds) = packet.time();
    let time = UnixTime::new_checked(seconds.into(), nanoseconds)?;
    let time = CdsTime::from_unix_time_with_u16_days(&time, SubmillisPrecision::Microseconds);
    let mut data = time.ok()?.to_vec().ok()?;
    data.extend_from_slice(packet.payload());
    let mut header = SpHeader::new_for_unseg_tm(u11::new(packet.kind().into()), sequence, 0);
    header.set_sec_header_flag();
    let packet = CcsdsPacketCreator::new(header, PacketType::Tm, &data, None);
    packet.ok().map(|packet| packet.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::id;
    use proptest::prelude::*;
    use spacepackets::{CcsdsPacket, CcsdsPacketReader};

    #[test]
    fn the_bytes_are_those_of_the_standard() {
        let time = (1_379_786_400, 250_123_456);
        let packet = TelemetryPacket::new(0x70, id::ASPECT, time, vec![0xAA, 0xBB]).unwrap();
        let bytes = space_packet(&packet, u14::new(5)).unwrap();
        // 2013-09-21 is day 20,352 since 1958; 18:00:00.250 is 64,800,250 ms.
        let expected = [
            &[0x08, 0x70, 0xC0, 0x05, 0x00, 0x0A][..],
            &[0x41, 0x4F, 0x80, 0x03, 0xDC, 0xC5, 0xFA, 0x00, 0x7B],
            &[0xAA, 0xBB],
        ];
        assert_eq!(bytes, expected.concat());
    }

    #[test]
    fn each_type_is_counted_by_itself_in_14_bits() {
        let mut sequences = Sequences::default();
        let count = |sequences: &mut Sequences| sequences.next(0x70).value();
        let own: Vec<u16> = (0..16_385).map(|_| count(&mut sequences)).collect();
        assert_eq!((own[0], own[16_383], own[16_384]), (0, 16_383, 0));
        assert_eq!(sequences.next(0x72).value(), 0);
    }

    #[test]
    fn a_payload_that_no_space_packet_can_hold_gives_none() {
        let of = |bytes| TelemetryPacket::new(0x82, id::ASPECT, (0, 0), vec![0; bytes]).unwrap();
        assert!(space_packet(&of(65_527), u14::new(0)).is_some());
        assert!(space_packet(&of(65_528), u14::new(0)).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(15_000))]
        #[test]
        fn any_telemetry_packet_comes_back_from_its_space_packet(
            kind: u8,
            sequence in 0_u16..16_384,
            seconds: u32,
            nanoseconds in 0_u32..1_000_000_000,
            payload in prop::collection::vec(any::<u8>(), 0..300),
        ) {
            let packet = TelemetryPacket::new(kind, id::ASPECT, (seconds, nanoseconds), payload).unwrap();
            let bytes = space_packet(&packet, u14::new(sequence)).unwrap();
            let read = CcsdsPacketReader::new(&bytes, None).unwrap();
            prop_assert_eq!(read.packet_len(), bytes.len());
            prop_assert_eq!((read.apid().value(), read.sp_header().seq_count().value()), (kind.into(), sequence));
            prop_assert!(read.sp_header().sec_header_flag());
            let (time, payload) = read.packet_data().split_at(9);
            prop_assert_eq!(payload, packet.payload());
            // By the standard: a day has 86,400,000 ms, and 1970 begins 4,383 days after 1958.
            let days = u64::from(u16::from_be_bytes([time[1], time[2]])) - 4_383;
            let ms = u64::from(u32::from_be_bytes([time[3], time[4], time[5], time[6]]));
            let us = u64::from(u16::from_be_bytes([time[7], time[8]]));
            let own = (days * 86_400_000 + ms) * 1000 + us;
            prop_assert_eq!(own, u64::from(seconds) * 1_000_000 + u64::from(nanoseconds) / 1000);
        }
    }
}
