//! The identity of a drawing: two plates with the same drawing have the same hash.

use super::{MarkShape, Plate};
use crate::provenance;
use crate::units::MIL_MM;
use std::fmt::Write;

const NM_PER_MIL: f64 = MIL_MM * 1e6;
/// A cross rotated by this angle is the same cross.
const QUARTER_TURN_UDEG: i64 = 90_000_000;

impl Plate {
    /// The drawing as text: the shape of the marks, then a line `i,j,x_nm,y_nm` for each mark, in the order of their ids.
    /// Lengths are whole nanometres, so that a table in mil and the same table in mm give the same text. Measured positions
    /// do not enter.
    pub fn drawing_text(&self) -> String {
        let mut text = match self.shape {
            MarkShape::Cross(cross) => {
                let length_nm = nanometres(cross.arm_length_mil);
                let width_nm = nanometres(cross.arm_width_mil);
                let angle_udeg = (cross.arm_angle_deg * 1e6).round() as i64;
                let angle_udeg = angle_udeg.rem_euclid(QUARTER_TURN_UDEG);
                format!("cross,{length_nm},{width_nm},{angle_udeg}\n")
            }
            MarkShape::Dot { diameter_mil } => format!("dot,{}\n", nanometres(diameter_mil)),
        };
        for (id, at) in self.drawn_marks() {
            let [x_nm, y_nm] = [at.x, at.y].map(nanometres);
            let written = writeln!(text, "{},{},{x_nm},{y_nm}", id.i, id.j);
            debug_assert!(written.is_ok(), "a string takes all");
        }
        text
    }

    /// SHA-256 of [`drawing_text`](Self::drawing_text), in hexadecimal digits.
    pub fn drawing_sha256(&self) -> String {
        provenance::sha256(self.drawing_text())
    }
}

fn nanometres(length_mil: f64) -> i64 {
    (length_mil * NM_PER_MIL).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plate::{Cross, MarkId, Pattern, read_table};
    use crate::units::PlateMil;

    fn plate(table: &str, arm_angle_deg: f64) -> Plate {
        let shape = MarkShape::Cross(Cross {
            arm_angle_deg,
            ..Cross::HEROES
        });
        Plate::new(Pattern::Table, shape, 1.0, read_table(table, 1.0).unwrap())
    }

    #[test]
    fn one_drawing_has_one_hash_whatever_its_unit_and_order() {
        let mil = plate("i,j,x_mil,y_mil\n1,0,1000.1,-500\n-2,3,0,40\n", 30.0);
        let mm = plate(
            "i,j,x_mm,y_mm\n-2,3,-0.0,1.016\n1,0,25.40254,-12.7\n",
            -60.0,
        );
        let text = "cross,2286000,304800,30000000\n-2,3,0,1016000\n1,0,25402540,-12700000\n";
        assert_eq!(mil.drawing_text(), text);
        assert_eq!(mm.drawing_text(), text);
        assert_eq!(mil.drawing_sha256().len(), 64);
    }

    #[test]
    fn a_measurement_leaves_the_hash_and_another_place_changes_it() {
        let table = "i,j,x_mil,y_mil\n1,0,1000,-500\n2,0,0,40\n";
        let drawn = plate(table, 0.0);
        let mut measured = drawn.clone();
        measured.set(
            MarkId { i: 1, j: 0 },
            PlateMil::new(1001.0, -500.0),
            [0.1; 2],
        );
        assert_eq!(measured.drawing_sha256(), drawn.drawing_sha256());
        let moved = plate(&table.replace("1000", "1000.001"), 0.0);
        assert_ne!(moved.drawing_sha256(), drawn.drawing_sha256());
    }
}
