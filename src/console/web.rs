//! Connections: accepted, answered, and closed if they stall.
//!
//! A slow client delays only itself. A head and a body have a time limit each; one address may take at most half of the
//! connections; and if none is free, the one is closed that has waited longest without a complete request.

use super::request::Failure;
use super::shared::Shared;
use axum::Router;
use axum::body::{Body, to_bytes};
use axum::extract::ConnectInfo;
use axum::http::{Request, StatusCode};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::task::AbortHandle;
use tokio::time::timeout;
use tower::ServiceExt;

/// Maximum number of connections, in all and from one address: a proxy's viewers share an address.
const MOST_CONNECTIONS: usize = 512;
const MOST_OF_ADDRESS: usize = 256;
/// Time limits for a request's head, and for its body after that.
const HEAD: Duration = Duration::from_secs(10);
const BODY: Duration = Duration::from_secs(10);
/// Maximum size of a request's body, bytes.
const LARGEST_BODY: usize = 16 * 1024;
/// Interval at which the end of the console is checked.
const POLL_EVERY: Duration = Duration::from_millis(100);
/// Number of threads for drawing.
const DRAWERS: usize = 4;

/// Serves until the console ends.
pub fn serve(listener: TcpListener, router: Router, shared: &Arc<Shared>) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(DRAWERS)
        .build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => return tracing::error!(%error, "the web server cannot begin"),
    };
    if let Err(error) = runtime.block_on(accept(listener, router, shared)) {
        tracing::error!(%error, "the web server has ended");
    }
    runtime.shutdown_timeout(Duration::from_secs(1));
}

async fn accept(listener: TcpListener, router: Router, shared: &Shared) -> std::io::Result<()> {
    listener.set_nonblocking(true)?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let mut places = Places::default();
    while !shared.is_over() {
        let Ok(accepted) = timeout(POLL_EVERY, listener.accept()).await else {
            continue;
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // For example, no more file descriptors: open connections may close.
                tracing::warn!(%error, "a connection cannot be taken");
                tokio::time::sleep(POLL_EVERY).await;
                continue;
            }
        };
        // If all places are taken by connections that have been served, the new one is closed at once.
        if places.make_space(peer.ip()) {
            let served = Arc::new(AtomicBool::new(false));
            let task = answer(stream, peer, router.clone(), Arc::clone(&served));
            places.0.push(Place {
                peer: peer.ip(),
                served,
                task: tokio::spawn(task).abort_handle(),
            });
        }
    }
    Ok(())
}

/// An open connection.
struct Place {
    peer: IpAddr,
    /// Whether a complete request has arrived over it.
    served: Arc<AtomicBool>,
    task: AbortHandle,
}

/// The open connections, the oldest first.
#[derive(Default)]
struct Places(Vec<Place>);

impl Places {
    /// Whether another connection from an address is allowed. It may replace one that has not been served yet.
    fn make_space(&mut self, peer: IpAddr) -> bool {
        self.0.retain(|place| !place.task.is_finished());
        let is_own = |place: &Place| place.peer == peer;
        let own = self.0.iter().filter(|place| is_own(place)).count();
        if own < MOST_OF_ADDRESS && self.0.len() < MOST_CONNECTIONS {
            return true;
        }
        let gives_way = |place: &Place| {
            let may = own < MOST_OF_ADDRESS || is_own(place);
            may && !place.served.load(Ordering::Relaxed)
        };
        let Some(oldest) = self.0.iter().position(gives_way) else {
            return false;
        };
        self.0.remove(oldest).task.abort();
        true
    }
}

/// Answers the requests on one connection.
async fn answer(stream: TcpStream, peer: SocketAddr, router: Router, served: Arc<AtomicBool>) {
    // An event must be sent at once, without waiting for the next.
    let _ = stream.set_nodelay(true);
    let service = service_fn(move |request: hyper::Request<Incoming>| {
        let (router, served) = (router.clone(), Arc::clone(&served));
        async move {
            let mut request = match whole(request.map(Body::new), BODY).await {
                Ok(request) => request,
                Err(failure) => return Ok::<Response, Infallible>(failure.into_response()),
            };
            served.store(true, Ordering::Relaxed);
            request.extensions_mut().insert(ConnectInfo(peer));
            router.oneshot(request).await
        }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .serve_connection(TokioIo::new(stream), service)
        .await;
    if let Err(error) = served {
        tracing::debug!(%error, %peer, "a connection has ended");
    }
}

/// A request with its complete body, which must arrive within a limit.
async fn whole(request: Request<Body>, limit: Duration) -> Result<Request<Body>, Failure> {
    let (head, body) = request.into_parts();
    match timeout(limit, to_bytes(body, LARGEST_BODY)).await {
        Ok(Ok(bytes)) => Ok(Request::from_parts(head, Body::from(bytes))),
        Ok(Err(_)) => Err(Failure(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("the request's body: expected {LARGEST_BODY} bytes or less"),
        )),
        Err(_) => Err(Failure(
            StatusCode::REQUEST_TIMEOUT,
            format!("the request's body: expected within {} s", limit.as_secs()),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::stream::{pending, repeat};

    fn runtime() -> tokio::runtime::Runtime {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all().build().unwrap()
    }

    fn place(peer: IpAddr, served: bool) -> Place {
        Place {
            peer,
            served: Arc::new(AtomicBool::new(served)),
            task: tokio::spawn(std::future::pending::<()>()).abort_handle(),
        }
    }

    #[test]
    fn slow_connections_of_one_address_keep_nobody_out() {
        runtime().block_on(async {
            let [hostile, other] = ["10.0.0.1", "10.0.0.2"].map(|ip| ip.parse().unwrap());
            let mut places = Places::default();
            for _ in 0..2000 {
                if places.make_space(hostile) {
                    places.0.push(place(hostile, false));
                }
            }
            assert_eq!(places.0.len(), MOST_OF_ADDRESS);
            assert!(places.make_space(other));
            // The same address gets a connection as well: the one that waited longest is closed.
            let oldest = places.0[0].task.clone();
            assert!(places.make_space(hostile));
            assert_eq!(places.0.len(), MOST_OF_ADDRESS - 1);
            while !oldest.is_finished() {
                tokio::task::yield_now().await;
            }
        });
    }

    #[test]
    fn viewers_that_are_served_keep_their_places() {
        runtime().block_on(async {
            let mut places = Places::default();
            for n in 0..MOST_CONNECTIONS {
                let peer = IpAddr::from([10, 0, (n / 200) as u8, (n % 200) as u8]);
                assert!(places.make_space(peer));
                places.0.push(place(peer, n != 300));
            }
            let newcomer = IpAddr::from([10, 9, 9, 9]);
            assert!(places.make_space(newcomer), "one was not served");
            places.0.push(place(newcomer, true));
            assert!(!places.make_space(newcomer));
        });
    }

    #[test]
    fn a_body_that_does_not_come_or_does_not_end_is_refused() {
        runtime().block_on(async {
            let body = |body| Request::builder().body(body).unwrap();
            let soon = Duration::from_millis(10);
            let never = Body::from_stream(pending::<Result<Vec<u8>, Infallible>>());
            let Err(Failure(status, words)) = whole(body(never), soon).await else {
                panic!("it came");
            };
            assert_eq!(status, StatusCode::REQUEST_TIMEOUT, "{words}");
            let endless = Body::from_stream(repeat(Ok::<_, Infallible>(vec![0u8; 1024])));
            let Err(Failure(status, words)) = whole(body(endless), BODY).await else {
                panic!("it ended");
            };
            assert_eq!(status, StatusCode::PAYLOAD_TOO_LARGE, "{words}");
            assert!(whole(body(Body::from("{}")), BODY).await.is_ok());
        });
    }
}
