//! Roles of cameras, each defined once with all of its names.

/// Role of a camera of a flight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// It observes the plate and is used by the controller.
    PitchYaw,
    /// It observes the horizon.
    Roll,
    Moon,
}

/// The names of a role.
struct Names {
    role: Role,
    /// Name in the configuration.
    name: &'static str,
    in_words: &'static str,
    /// Its target, and the command that finds the target in a file.
    target: &'static str,
    command: &'static str,
    /// The tables of the configuration whose cameras have this role by default.
    tables: &'static [&'static str],
    /// Name of its camera's frames, folders and logs, and its instrument in headers; none if the instrument has a name of
    /// its own.
    label: Option<&'static str>,
    /// Number of its first camera on the serial line.
    number: u8,
    /// Which of its cameras need a file that states their target, and the kind of file.
    file: (Need, &'static str),
}

/// Which cameras need a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Need {
    /// All except simulated ones and folders.
    Real,
    All,
    /// None; without it, frames are stored but not solved.
    No,
}

const ROLES: [Names; Role::COUNT] = [
    Names {
        role: Role::PitchYaw,
        name: "pitch_yaw",
        in_words: "pitch-yaw camera",
        target: "Sun",
        command: "solve",
        tables: &["camera", "second_camera"],
        label: None,
        number: 1,
        file: (Need::Real, "the instrument's file, for a real camera"),
    },
    Names {
        role: Role::Roll,
        name: "roll",
        in_words: "roll camera",
        target: "horizon",
        command: "horizon",
        tables: &["roll_camera"],
        label: Some("roll"),
        number: 6,
        file: (Need::No, "the file of the camera that sees the horizon"),
    },
    Names {
        role: Role::Moon,
        name: "moon",
        in_words: "Moon camera",
        target: "Moon",
        command: "moon",
        tables: &["moon_camera"],
        label: Some("moon"),
        number: 7,
        file: (Need::All, "the file of the camera that sees the Moon"),
    },
];

/// Pitch-yaw cameras have the numbers from 1 to this on the serial line; the remaining ones, and further cameras of other
/// roles, have numbers above [`Role::LAST`].
const MOST_PITCH_YAW: u8 = 5;

impl Role {
    pub const COUNT: usize = 3;
    pub const KINDS: [Self; Self::COUNT] = [Self::PitchYaw, Self::Roll, Self::Moon];
    pub const NAMES: [&'static str; Self::COUNT] = [ROLES[0].name, ROLES[1].name, ROLES[2].name];
    /// The largest number on the serial line of a role's first camera.
    const LAST: u8 = 7;
    /// The largest number that fits into an image packet.
    pub const MOST_NUMBERED: u8 = 15;

    fn names(self) -> &'static Names {
        &ROLES[self as usize]
    }

    pub fn name(self) -> &'static str {
        self.names().name
    }

    pub fn in_words(self) -> &'static str {
        self.names().in_words
    }

    /// Its target, in words.
    pub fn target(self) -> &'static str {
        self.names().target
    }

    /// The command of the program that finds the target in a file.
    pub fn command(self) -> &'static str {
        self.names().command
    }

    /// The kind of file that a camera needs to fly; `None` if it needs none.
    pub fn needed_file(self, is_real: bool) -> Option<&'static str> {
        let (need, file) = self.names().file;
        let is_needed = need == Need::All || (need == Need::Real && is_real);
        is_needed.then_some(file)
    }

    /// The configuration's tables of cameras with a default role.
    pub fn tables() -> impl Iterator<Item = (&'static str, Self)> {
        let tables = |names: &'static Names| names.tables.iter().map(|table| (*table, names.role));
        ROLES.iter().flat_map(tables)
    }

    /// The names of these tables.
    pub fn table_names() -> Vec<&'static str> {
        Self::tables().map(|(table, _)| table).collect()
    }

    /// The table of its `ordinal`-th camera (from 1), if it has one.
    pub fn table(self, ordinal: usize) -> Option<&'static str> {
        let tables = self.names().tables;
        tables.get(ordinal.checked_sub(1)?).copied()
    }

    /// Prefix of the names of its `ordinal`-th camera's frames (from 1); `None` if the instrument names them.
    pub fn label(self, ordinal: usize) -> Option<String> {
        Some(of_several(self.names().label?, ordinal))
    }

    /// The role and the ordinal of a camera whose frames have this prefix; `None` for the name of an instrument.
    pub fn labelled(name: &str) -> Option<(Self, usize)> {
        let (label, ordinal) = one_of_several(name);
        let names = ROLES.iter().find(|names| names.label == Some(label))?;
        Some((names.role, ordinal))
    }

    /// Numbers on the serial line of cameras with these roles, in their order. Those of a role's first camera are always
    /// the same.
    pub fn numbers(roles: &[Self]) -> Vec<u8> {
        let mut further = Self::LAST;
        let number = |(index, role): (usize, &Self)| {
            let before = roles[..index].iter().filter(|other| *other == role).count();
            let first = role.names().number;
            match u8::try_from(before).map_or(u8::MAX, |before| first.saturating_add(before)) {
                number if before == 0 => number,
                number if *role == Self::PitchYaw && number <= MOST_PITCH_YAW => number,
                _ => {
                    further = further.saturating_add(1);
                    further
                }
            }
        };
        roles.iter().enumerate().map(number).collect()
    }

    /// Name of a camera with a number on the serial line, if the number alone determines it.
    pub fn numbered(number: u8) -> Option<String> {
        let is_one = |names: &&Names| names.number == number;
        match ROLES.iter().find(is_one) {
            Some(names) => Some(names.in_words.into()),
            None if number == 2 => Some(format!("second {}", Self::PitchYaw.in_words())),
            None => None,
        }
    }

    /// Its first camera's number on the serial line.
    pub fn number(self) -> u8 {
        self.names().number
    }
}

/// The name of one of several cameras with the same base name, by its ordinal from 1.
pub fn of_several(name: &str, ordinal: usize) -> String {
    match ordinal {
        ..=1 => name.into(),
        _ => format!("{name}-{ordinal}"),
    }
}

/// The base name of such a camera, and its ordinal.
pub fn one_of_several(name: &str) -> (&str, usize) {
    let split = name.rsplit_once('-').and_then(|(shared, number)| {
        let ordinal = number.parse().ok().filter(|ordinal| *ordinal > 1)?;
        // In the format of `of_several`.
        (number.starts_with(|c: char| c.is_ascii_digit() && c != '0')).then_some((shared, ordinal))
    });
    split.unwrap_or((name, 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use Role::{Moon, PitchYaw, Roll};

    #[test]
    fn a_row_of_the_table_stands_at_its_roles_place() {
        for role in Role::KINDS {
            assert_eq!(role.names().role, role);
            assert!(role.number() <= Role::LAST);
        }
    }

    #[test]
    fn a_roles_first_camera_has_its_own_number_and_no_two_cameras_have_the_same() {
        let usual = [PitchYaw, PitchYaw, Roll, Moon];
        assert_eq!(Role::numbers(&usual), [1, 2, 6, 7]);
        assert_eq!(Role::numbers(&[PitchYaw, Roll, Roll, Moon]), [1, 6, 8, 7]);
        let mut many = Role::numbers(&[PitchYaw, PitchYaw, Roll, Roll, PitchYaw, Moon, Moon]);
        assert_eq!(many, [1, 2, 6, 8, 3, 7, 9]);
        many.sort_unstable();
        many.dedup();
        assert_eq!(many.len(), 7);
    }

    #[test]
    fn a_label_gives_role_and_ordinal() {
        for (role, ordinal) in [(Roll, 1), (Roll, 2), (Moon, 1), (Moon, 12)] {
            let label = role.label(ordinal).unwrap();
            assert_eq!(Role::labelled(&label), Some((role, ordinal)));
        }
        for instrument in [
            "pyas-f", "rollo", "roll-x", "roll-1", "roll-02", "demo-2", "",
        ] {
            assert_eq!(Role::labelled(instrument), None, "{instrument}");
        }
        assert_eq!(PitchYaw.label(1), None);
    }
}
