//! Numbers packed into few bytes, as commands and housekeeping carry them (HEROES flight program, 2013).

use crate::units::SensorPx;

/// The largest 12-bit code.
const CODE12_MAX: f64 = 4095.0;

/// The 16-bit code of a number: `round(8 (value + 1024))`. `None` outside -1024 to 7167.875.
///
/// Used for angles (deg), clocking and twist, in steps of 1/8.
pub fn angle_code(value: f64) -> Option<u16> {
    let code = (8.0 * (value + 1024.0)).round();
    (0.0..=f64::from(u16::MAX))
        .contains(&code)
        .then_some(code as u16)
}

/// The number that a 16-bit code represents: `code / 8 - 1024`.
pub fn angle_from_code(code: u16) -> f64 {
    f64::from(code) / 8.0 - 1024.0
}

/// A position on the sensor in three bytes: two 12-bit codes `round(3 v + 105)`, x first, in steps of 1/3 px.
/// `None` outside -35 to 1330 px.
pub fn pair3b(position: SensorPx) -> Option<[u8; 3]> {
    let (x, y) = (code12(position.x)?, code12(position.y)?);
    let [_, high, middle, low] = (x << 12 | y).to_be_bytes();
    Some([high, middle, low])
}

/// The position that three bytes of [`pair3b`] represent.
pub fn position_from_pair3b(bytes: [u8; 3]) -> SensorPx {
    let [high, middle, low] = bytes;
    let codes = u32::from_be_bytes([0, high, middle, low]);
    let px = |code: u32| (f64::from(code) - 105.0) / 3.0;
    SensorPx::new(px(codes >> 12), px(codes & 0xFFF))
}

fn code12(px: f64) -> Option<u32> {
    let code = (3.0 * px + 105.0).round();
    (0.0..=CODE12_MAX).contains(&code).then_some(code as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_number_outside_its_code_is_refused() {
        assert_eq!(angle_code(-1024.0), Some(0));
        assert_eq!(angle_code(7167.875), Some(u16::MAX));
        assert_eq!(angle_code(-1024.1), None);
        assert_eq!(angle_code(f64::NAN), None);
        assert_eq!(pair3b(SensorPx::new(-36.0, 0.0)), None);
        assert_eq!(pair3b(SensorPx::new(0.0, f64::NAN)), None);
    }

    proptest! {
        #[test]
        fn an_angle_survives_its_code_to_a_sixteenth(value in -1024.0..7167.8) {
            let code = angle_code(value).unwrap();
            prop_assert!((angle_from_code(code) - value).abs() <= 1.0 / 16.0);
        }

        #[test]
        fn a_position_survives_its_three_bytes_to_a_sixth_of_a_pixel(x in -35.0..1330.0, y in -35.0..1330.0) {
            let read = position_from_pair3b(pair3b(SensorPx::new(x, y)).unwrap());
            prop_assert!((read.x - x).abs() < 0.167 && (read.y - y).abs() < 0.167);
        }
    }
}
