//! The two computers of the aspect system.

/// The bits of a command's key that select computers.
pub const COMPUTERS: u16 = 0xF000;

/// One of the two computers of the aspect system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Computer {
    One,
    Two,
}

impl Computer {
    /// The computer of a number, 1 or 2.
    pub fn numbered(number: u32) -> Option<Self> {
        match number {
            1 => Some(Self::One),
            2 => Some(Self::Two),
            _ => None,
        }
    }

    pub fn number(self) -> u8 {
        match self {
            Self::One => 1,
            Self::Two => 2,
        }
    }

    /// Whether it sends solutions unless a command changes that.
    pub fn sends_by_default(self) -> bool {
        self == Self::One
    }

    /// Whether a command with this key is for this computer. It may be for both, or for none.
    pub fn is_addressed_by(self, key: u16) -> bool {
        key & self.bit() != 0
    }

    /// The bit of a key that selects it.
    pub fn bit(self) -> u16 {
        match self {
            Self::One => 0x1000,
            Self::Two => 0x2000,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_may_be_for_one_computer_for_both_or_for_none() {
        let both = [Computer::One, Computer::Two];
        let addressed = |key| both.map(|computer| computer.is_addressed_by(key));
        assert_eq!(addressed(0x1412), [true, false]);
        assert_eq!(addressed(0x2412), [false, true]);
        assert_eq!(addressed(0x3412), [true, true]);
        assert_eq!(addressed(0x0412), [false, false]);
        assert_eq!(addressed(0x4412), [false, false]);
    }
}
