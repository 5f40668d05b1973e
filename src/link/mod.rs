//! The line to the gondola's controller: packets, messages, the conversation and the port.
//!
//! ```text
//! port (bytes) -> Parser -> Packet -> Message -> Responder -> packets to send and changes
//! ```
//!
//! Nothing here starts a thread or reads a clock: times are arguments, and the flight service owns the loop.
//! The interface is that of the HEROES flight program (2013, repository HEROES-GSFC/SAS); `docs/protocol.md`
//! describes it in tables.

pub mod byte_log;
pub mod code;
pub mod computer;
pub mod connection;
pub mod control;
pub mod fields;
pub mod ground;
pub mod guard;
pub mod hex;
pub mod housekeeping;
pub mod imu;
pub mod in_process;
pub mod key;
pub mod message;
pub mod moon;
pub mod number;
pub mod packet;
pub mod parser;
pub mod picture;
pub mod port;
pub mod responder;
pub mod telemetry;
pub mod udp;

#[cfg(test)]
mod tables;

pub use computer::Computer;
pub use connection::{AnyPort, Connection, PortAddress};
pub use control::{Carried, CommandResult, Control};
pub use guard::{Guard, Peer};
pub use housekeeping::{Counters, Counts, Housekeeping};
pub use imu::ImuPacket;
pub use in_process::{Controller, InProcess};
pub use key::{Key, Seal};
pub use message::{
    AspectCommand, ExposureStart, GpsFix, Message, MessageError, Messages, MoonRequest, NoSolution,
    Propagated, Solution,
};
pub use moon::{MoonAnswer, MoonFix, MoonOutcome};
pub use packet::{CommandPacket, Direction, Packet, PacketError, TelemetryPacket, id};
pub use parser::{Parser, Rejected};
pub use picture::Picture;
pub use port::{BytePort, PortError, SerialPort};
pub use responder::{Execution, Exposure, LinkState, ReceivedCommand, Reply, Responder};
pub use telemetry::{CameraCounts, CommandOutcome, FrameMarks, Receipt, Telemetry};
pub use udp::{LocalEnd, UdpPort};
