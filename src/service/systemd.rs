//! The service manager, if it has started this program (`Type=notify`, `WatchdogSec`): it is notified that the flight is
//! ready, that it is alive, and that it ends.
//!
//! The crate `sd-notify` sends only to sockets of the file system; systemd may use one of Linux's abstract ones.

use sd_notify::NotifyState;
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Environment variable with the socket's address.
const VARIABLE: &str = "NOTIFY_SOCKET";
const EXPECTED: &str =
    "an absolute path of at most 107 bytes, or @NAME for an abstract socket (no vsock)";
/// Longest wait for a service manager that reads nothing: it must not delay the watch.
const TIMEOUT: Duration = Duration::from_millis(100);

pub(super) struct Systemd {
    /// Whether a service manager starts the program again.
    pub is_there: bool,
    /// `None` without a service manager.
    address: Option<SocketAddr>,
    every: Option<Duration>,
    fed: Instant,
    failed: u64,
}

impl Systemd {
    /// Finds the service manager by the environment, and notifies it that the flight is ready.
    pub fn ready() -> Self {
        let socket = std::env::var_os(VARIABLE);
        let address = socket.as_deref().and_then(|text| {
            let address = address(text);
            if address.is_none() {
                let found = text.to_string_lossy();
                tracing::warn!(
                    "{VARIABLE}: expected {EXPECTED}, found \"{found}\": systemd is not notified that the flight lives, and its \
                     watchdog may end it"
                );
            }
            address
        });
        let mut systemd = Self {
            is_there: socket.is_some(),
            address,
            // Twice as often as the service manager requires.
            every: sd_notify::watchdog_enabled().map(|timeout| timeout / 2),
            fed: Instant::now(),
            failed: 0,
        };
        systemd.notify(&NotifyState::Ready);
        systemd
    }

    /// Only the watch feeds it: cameras and solvers that hang are started again here; if the watch or the line hangs, systemd
    /// restarts the program.
    pub fn feed(&mut self) {
        if self.every.is_some_and(|every| self.fed.elapsed() >= every) {
            self.fed = Instant::now();
            self.notify(&NotifyState::Watchdog);
        }
    }

    pub fn stopping(&mut self) {
        self.notify(&NotifyState::Stopping);
    }

    fn notify(&mut self, state: &NotifyState) {
        let Some(address) = &self.address else {
            return;
        };
        if let Err(error) = send(address, &format!("{state}\n")) {
            self.failed += 1;
            if self.failed.is_power_of_two() {
                let failed = self.failed;
                tracing::warn!(%error, failed, "systemd was not notified: {state}");
            }
        }
    }
}

/// The address of a socket as systemd writes it; `None` if it is not that of a Unix socket.
fn address(text: &OsStr) -> Option<SocketAddr> {
    match text.as_bytes() {
        [b'@', name @ ..] if !name.is_empty() => SocketAddr::from_abstract_name(name).ok(),
        [b'/', ..] => SocketAddr::from_pathname(text).ok(),
        _ => None,
    }
}

fn send(address: &SocketAddr, message: &str) -> io::Result<()> {
    let socket = UnixDatagram::unbound()?;
    socket.set_write_timeout(Some(TIMEOUT))?;
    socket.send_to_addr(message.as_bytes(), address).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sockets_of_the_file_system_and_abstract_ones_are_reached() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify").display().to_string();
        let name = format!("@solaspect-test/{}", std::process::id());
        for text in [path, name] {
            let address = address(OsStr::new(&text)).unwrap();
            let socket = UnixDatagram::bind_addr(&address).unwrap();
            send(&address, "READY=1\n").unwrap();
            let mut buffer = [0; 64];
            let count = socket.recv(&mut buffer).unwrap();
            assert_eq!(&buffer[..count], b"READY=1\n", "{text}");
        }
    }

    #[test]
    fn what_is_no_address_of_a_unix_socket_is_none() {
        let long = format!("/{}", "x".repeat(120));
        for text in ["", "@", "notify", "vsock:2:1234", "vsock-stream:2:1", &long] {
            assert!(address(OsStr::new(text)).is_none(), "{text}");
        }
    }
}
