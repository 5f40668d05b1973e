//! The camera's thread: it executes orders one after the other.

use super::opened::{Fault, OpenCamera, Opening};
use crate::camera::{CameraError, CameraSettings};
use crate::frame::Frame;
use crossbeam_channel::{Receiver, Sender, unbounded};
use std::time::{Duration, Instant};

enum Order {
    Take,
    Apply(Box<CameraSettings>),
}

/// Reports of the thread.
pub(super) enum Report {
    /// The camera is open, and has its settings.
    Ready,
    Taken(Box<Result<Frame, CameraError>>),
    Applied(Result<(), CameraError>),
    /// The camera is lost, and the thread ends.
    Gone(CameraError),
}

/// Connection to the thread. When it is dropped, the thread ends after its present order.
pub(super) struct Link {
    orders: Sender<Order>,
    reports: Receiver<Report>,
}

impl Link {
    /// Starts the thread. It outlives the camera at most by the call in which the camera hangs.
    pub(super) fn open(opening: Opening) -> std::io::Result<Self> {
        // Neither queue grows: one frame is ordered at a time.
        let (orders, ordered) = unbounded();
        let (report, reports) = unbounded();
        std::thread::Builder::new()
            .name("camera".into())
            .spawn(move || run(opening, &ordered, &report))?;
        Ok(Self { orders, reports })
    }

    /// Orders a frame. A thread that has ended has reported so itself.
    pub(super) fn take_frame(&self) {
        let _ = self.orders.send(Order::Take);
    }

    pub(super) fn apply(&self, settings: &CameraSettings) {
        let _ = self.orders.send(Order::Apply(Box::new(settings.clone())));
    }

    /// The next report of the thread, within `wait`; `None` without one.
    pub(super) fn report(&self, wait: Duration) -> Option<Report> {
        match self.reports.recv_timeout(wait) {
            Ok(report) => Some(report),
            Err(error) => {
                if error.is_disconnected() {
                    // It reported the reason when it ended; only a panic gives no report. The sleep avoids a busy loop then.
                    std::thread::sleep(wait);
                }
                None
            }
        }
    }

    /// Waits for the thread to end.
    pub(super) fn close(self, wait: Duration) {
        drop(self.orders);
        let deadline = Instant::now() + wait;
        while self.reports.recv_deadline(deadline).is_ok() {}
    }
}

fn run(opening: Opening, orders: &Receiver<Order>, reports: &Sender<Report>) {
    // A missing receiver is no failure: the camera was given up.
    if let Err(error) = serve(opening, orders, reports) {
        let _ = reports.send(Report::Gone(error));
    }
}

fn serve(
    opening: Opening,
    orders: &Receiver<Order>,
    reports: &Sender<Report>,
) -> Result<(), CameraError> {
    let mut camera = OpenCamera::open(opening)?;
    let mut report = Report::Ready;
    while reports.send(report).is_ok() {
        let Ok(order) = orders.recv() else { break };
        report = match order {
            Order::Apply(settings) => Report::Applied(camera.apply(&settings)?),
            Order::Take => match camera.take_frame() {
                Ok(frame) => Report::Taken(Box::new(Ok(frame))),
                Err(Fault::Frame(error)) => Report::Taken(Box::new(Err(error))),
                Err(Fault::Camera(error)) => return Err(error),
            },
        };
    }
    Ok(())
}
