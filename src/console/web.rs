//! Connections: taken in, answered, and closed when they stall.

use super::shared::Shared;
use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tower::ServiceExt;

/// Connections at a time.
const MOST_CONNECTIONS: usize = 512;
/// In which a request's head must be there.
const HEAD: Duration = Duration::from_secs(10);
/// How often the end of the console is looked for.
const LOOK: Duration = Duration::from_millis(100);
/// Threads that draw and read files.
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
    let places = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    while !shared.is_over() {
        let Ok(accepted) = timeout(LOOK, listener.accept()).await else {
            continue;
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // No more descriptors, for one: those that are open may close.
                tracing::warn!(%error, "a connection cannot be taken");
                tokio::time::sleep(LOOK).await;
                continue;
            }
        };
        // Where all places are taken, the connection closes at once.
        if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
            let router = router.clone();
            tokio::spawn(async move {
                answer(stream, peer, router).await;
                drop(place);
            });
        }
    }
    Ok(())
}

/// Answers the requests of one connection.
async fn answer(stream: TcpStream, peer: SocketAddr, router: Router) {
    // An event is a packet of its own: it must not wait for the next.
    let _ = stream.set_nodelay(true);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(ConnectInfo(peer));
        router.clone().oneshot(request.map(Body::new))
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
