//! Packets from the line, and their answers.

use super::Line;
use crate::commands::CommandNote;
use crate::commands::words::{CommandInWords, execution_in_words};
use crate::link::guard::Refusal;
use crate::link::{CommandPacket, Packet, TelemetryPacket};
use crate::log::worth_a_line;
use jiff::Timestamp;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

/// More than the longest datagram.
const READ_BYTES: usize = 2048;
/// Datagrams handled per turn: a flood of them must not delay packets that are to be sent.
const DATAGRAMS: usize = 64;

impl Line<'_> {
    /// Reads received packets and answers them.
    pub(super) fn receive(&mut self) {
        let mut buffer = [0; READ_BYTES];
        for _ in 0..DATAGRAMS {
            let Some(port) = self.connection.port() else {
                return;
            };
            let count = match port.read(&mut buffer, Duration::ZERO) {
                Ok(count) => count,
                Err(error) => return self.lose(&error),
            };
            let Some(sender) = port.sender() else {
                self.receive_bytes(&buffer[..count]);
                break;
            };
            self.receive_datagram(&buffer[..count], sender);
        }
        self.tally.lock().rejected = self.parser.rejected();
    }

    fn receive_bytes(&mut self, bytes: &[u8]) {
        for packet in self.parser.feed(bytes, self.start.elapsed()) {
            match packet {
                Packet::Command(packet) => {
                    let sender = self.settings.port.clone();
                    self.execute(&packet, &sender.unwrap_or_else(|| "line".to_owned()));
                }
                Packet::Telemetry(packet) => self.receive_telemetry(&packet),
            }
        }
    }

    /// Takes samples of the IMU; without a filter they are dropped.
    fn receive_telemetry(&self, packet: &TelemetryPacket) {
        if let Some(inputs) = &self.navigation {
            inputs.receive_sample(packet, Instant::now());
        }
    }

    fn receive_datagram(&mut self, datagram: &[u8], sender: SocketAddr) {
        let guard = self.connection.guard();
        guard.refuse_to(self.controls.stamp_ns());
        let opened = match guard.open(datagram, sender) {
            Ok(opened) => opened,
            Err(refusal) => return self.refuse(refusal, None, sender),
        };
        let packets = self.parser.feed(opened.bytes, self.start.elapsed());
        // No packet continues in the next datagram.
        self.parser.abandon();
        for packet in packets {
            match packet {
                Packet::Command(packet) => {
                    self.note_stamp();
                    self.execute_once(packet, sender, opened.is_new);
                }
                // A sample that comes again carries nothing new.
                Packet::Telemetry(packet) if opened.is_new => self.receive_telemetry(&packet),
                Packet::Telemetry(_) => {}
            }
        }
    }

    /// Saves the newest stamp for the next start. Stamps of samples are too frequent for a file.
    fn note_stamp(&mut self) {
        let newest = self.connection.guard().newest_stamp();
        if newest > self.controls.stamp_ns() {
            self.controls.note_stamp_ns(newest);
        }
    }

    /// Executes a packet of a datagram, unless it was executed before.
    fn execute_once(&mut self, packet: CommandPacket, sender: SocketAddr, is_new: bool) {
        let now = Instant::now();
        match self.connection.guard().admit(&packet, sender, is_new, now) {
            Ok(None) => {
                let answers = self.execute(&packet, &sender.to_string());
                let guard = self.connection.guard();
                guard.remember(packet, sender, answers, now);
            }
            Ok(Some(answers)) => {
                self.repeated += 1;
                if worth_a_line(self.repeated) {
                    let result = format!("came again ({}): answered again", self.repeated);
                    self.note_commands(&packet, sender, &result);
                }
                self.answer(&answers);
            }
            Err(refusal) => self.refuse(refusal, Some(&packet), sender),
        }
    }

    /// Refuses a datagram; `packet` is its packet, if it could be read.
    fn refuse(&mut self, refusal: Refusal, packet: Option<&CommandPacket>, sender: SocketAddr) {
        let refused = self.counters.datagrams_refused.count();
        if worth_a_line(refused) {
            tracing::warn!(%sender, %refusal, refused, "a datagram was refused");
            let result = format!("refused ({refused}): {refusal}");
            match packet {
                Some(packet) => self.note_commands(packet, sender, &result),
                None => {
                    let unread = CommandInWords::default();
                    let note = CommandNote::now(sender, unread, result);
                    self.controls.note_command(note);
                }
            }
        }
    }

    /// Writes the result for a packet that was not executed into the command log.
    fn note_commands(&self, packet: &CommandPacket, sender: SocketAddr, result: &str) {
        for (key, message) in self.responder.commands_in(packet) {
            let command = CommandInWords::of(key, message.as_ref());
            let note = CommandNote::now(sender, command, result);
            self.controls.note_command(note);
        }
    }

    /// Executes a packet; returns its answers.
    fn execute(&mut self, packet: &CommandPacket, sender: &str) -> Vec<Vec<u8>> {
        let now = Timestamp::now();
        match self.responder.handle(packet, now, &mut self.controls) {
            Ok(reply) => {
                self.tally.lock().commands += reply.commands.len() as u64;
                for executed in &reply.commands {
                    let command = CommandInWords::of(executed.key, executed.message.as_ref());
                    let result = execution_in_words(executed.key, &executed.execution);
                    let note = CommandNote::now(sender, command, result);
                    self.controls.note_command(note);
                }
                self.answer(&reply.packets);
                if reply.changed {
                    self.note_conversation();
                }
                self.request_moon(&reply.moon_requests);
                reply.packets
            }
            Err(error) => {
                self.note_unsent(&error, "a command was not answered");
                Vec::new()
            }
        }
    }
}
