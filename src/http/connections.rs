//! The open connections: which are accepted when there are many, and which are closed.
//!
//! Every connection is accepted. With [`CONNECTIONS`] open, or too many from one address, the one
//! that has been silent for longest is closed; silent clients, and clients that do not read, can
//! therefore keep no other out. If all are being answered, a new client is only answered about
//! health. Above [`CONNECTIONS`] + [`FOR_HEALTH`], no connection is accepted.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio::time::Sleep;

use crate::locks::lock;

/// How many connections are open at once.
const CONNECTIONS: usize = 256;
/// How many more, for requests about health only.
const FOR_HEALTH: usize = 32;
/// How many connections from one address; this machine itself may have all of them.
const FROM_ADDRESS: usize = 64;
/// How long a client may go without reading what is written to it.
const WRITE_TIME: Duration = Duration::from_secs(20);

/// The open connections.
#[derive(Debug)]
pub(super) struct Connections {
    since: Instant,
    open: Mutex<Vec<Arc<OpenConnection>>>,
}

/// An open connection.
#[derive(Debug)]
pub(super) struct OpenConnection {
    address: IpAddr,
    /// Whether it is answered about health only.
    pub(super) is_crowded: bool,
    since: Instant,
    /// The number of requests that are being answered.
    answering: AtomicUsize,
    /// When it was last active, in milliseconds since the start.
    active_ms: AtomicU64,
    evicted: Notify,
}

/// A request that is being answered.
#[derive(Debug)]
pub(super) struct Answering(Arc<OpenConnection>);

impl Connections {
    pub(super) fn new() -> Self {
        Self { since: Instant::now(), open: Mutex::default() }
    }

    /// Accepts a client; if there are too many, a silent one is closed for it. `None` if all are
    /// being answered and those reserved for health are taken too, or if its address has as many as
    /// it may have and all of these are being answered.
    pub(super) fn admit(&self, client: SocketAddr) -> Option<Arc<OpenConnection>> {
        let address = client.ip().to_canonical();
        let mut open = self.lock();
        loop {
            let of_address = open.iter().filter(|known| known.address == address).count();
            let of_one = of_address >= FROM_ADDRESS && !address.is_loopback();
            if !of_one && open.len() < CONNECTIONS {
                break;
            }
            let is_silent = |known: &&Arc<OpenConnection>| {
                known.answering.load(Ordering::Relaxed) == 0
                    && (!of_one || known.address == address)
            };
            let silent = open.iter().filter(is_silent).min_by_key(|known| known.active_ms());
            match silent.cloned() {
                Some(silent) => {
                    open.retain(|known| !Arc::ptr_eq(known, &silent));
                    silent.evicted.notify_one();
                }
                None if of_one || open.len() >= CONNECTIONS + FOR_HEALTH => return None,
                None => break,
            }
        }
        let connection = Arc::new(OpenConnection {
            address,
            is_crowded: open.len() >= CONNECTIONS,
            since: self.since,
            answering: AtomicUsize::new(0),
            active_ms: AtomicU64::new(milliseconds(self.since)),
            evicted: Notify::new(),
        });
        open.push(Arc::clone(&connection));
        Some(connection)
    }

    /// Removes a connection that has ended.
    pub(super) fn remove(&self, connection: &Arc<OpenConnection>) {
        self.lock().retain(|known| !Arc::ptr_eq(known, connection));
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<OpenConnection>>> {
        lock(&self.open)
    }
}

impl OpenConnection {
    /// Marks the connection as answering a request until the returned value is dropped.
    pub(super) fn answering(self: &Arc<Self>) -> Answering {
        self.answering.fetch_add(1, Ordering::Relaxed);
        Answering(Arc::clone(self))
    }

    /// Resolves when the connection is to be closed for another.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    fn active_ms(&self) -> u64 {
        self.active_ms.load(Ordering::Relaxed)
    }

    fn note_activity(&self) {
        self.active_ms.store(milliseconds(self.since), Ordering::Relaxed);
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.note_activity();
        self.0.answering.fetch_sub(1, Ordering::Relaxed);
    }
}

fn milliseconds(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX)
}

/// A connection's stream: it records activity, and fails once the client has read nothing for
/// [`WRITE_TIME`] while there was something to write.
#[derive(Debug)]
pub(super) struct WatchedStream<S> {
    stream: S,
    connection: Arc<OpenConnection>,
    /// The time limit of a write that is waiting.
    deadline: Option<Pin<Box<Sleep>>>,
}

impl<S> WatchedStream<S> {
    pub(super) fn new(stream: S, connection: Arc<OpenConnection>) -> Self {
        Self { stream, connection, deadline: None }
    }

    /// Returns the result of a write; one that has waited too long fails.
    fn watched<T>(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.connection.note_activity();
            self.deadline = None;
            return written;
        }
        let deadline =
            self.deadline.get_or_insert_with(|| Box::pin(tokio::time::sleep(WRITE_TIME)));
        ready!(deadline.as_mut().poll(context));
        Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client does not read")))
    }
}

impl WatchedStream<TcpStream> {
    /// The first byte received, which is left in the stream.
    pub(super) async fn first_byte(&mut self) -> io::Result<u8> {
        let mut first = [0];
        match self.stream.peek(&mut first).await? {
            0 => Err(io::ErrorKind::UnexpectedEof.into()),
            _ => Ok(first[0]),
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for WatchedStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if read.is_ready() {
            self.connection.note_activity();
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for WatchedStream<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.watched(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        self.watched(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(address: [u8; 4], port: u16) -> SocketAddr {
        (IpAddr::from(address), port).into()
    }

    /// As if it had last been active so long after the start.
    fn active(connection: &OpenConnection, ms: u64) {
        connection.active_ms.store(ms, Ordering::Relaxed);
    }

    #[tokio::test]
    async fn the_one_that_was_silent_for_longest_makes_room() {
        let connections = Connections::new();
        let open: Vec<_> = (0..CONNECTIONS)
            .map(|port| connections.admit(client([127, 0, 0, 1], port as u16)).unwrap())
            .collect();
        open.iter().zip(100..).for_each(|(connection, ms)| active(connection, ms));
        active(&open[7], 3);
        let answering = open[7].answering();
        active(&open[9], 5);
        let newcomer = connections.admit(client([127, 0, 0, 1], 999)).unwrap();
        assert!(!newcomer.is_crowded);
        // 7 has been silent for longer, but is being answered.
        open[9].evicted().await;
        assert_eq!(connections.lock().len(), CONNECTIONS);
        drop(answering);
        connections.remove(&newcomer);
        assert_eq!(connections.lock().len(), CONNECTIONS - 1);
    }

    #[test]
    fn where_all_are_answered_there_is_room_for_health_alone() {
        let connections = Connections::new();
        let admit = || connections.admit(client([127, 0, 0, 1], 1));
        let answered: Vec<_> =
            (0..CONNECTIONS).map(|_| admit().map(|open| open.answering()).unwrap()).collect();
        assert!(admit().unwrap().is_crowded);
        assert!(admit().unwrap().is_crowded, "in place of the one before, which is silent");
        connections.lock().truncate(CONNECTIONS);
        let crowded = (0..FOR_HEALTH).map(|_| admit().filter(|open| open.is_crowded).unwrap());
        let busy: Vec<_> = crowded.map(|open| open.answering()).collect();
        assert!(admit().is_none());
        drop((answered, busy));
        assert!(admit().is_some_and(|connection| !connection.is_crowded));
    }

    #[test]
    fn one_address_does_not_get_all() {
        let connections = Connections::new();
        let other = connections.admit(client([10, 0, 0, 2], 1)).unwrap();
        active(&other, 0);
        let greedy: Vec<_> = (0..FROM_ADDRESS)
            .map(|port| connections.admit(client([10, 0, 0, 1], port as u16)).unwrap())
            .collect();
        assert!(connections.admit(client([10, 0, 0, 1], 999)).is_some());
        assert_eq!(connections.lock().len(), FROM_ADDRESS + 1);
        assert!(connections.lock().iter().any(|open| Arc::ptr_eq(open, &other)), "it is its own");
        let busy: Vec<_> = connections.lock().iter().map(OpenConnection::answering).collect();
        assert!(connections.admit(client([10, 0, 0, 1], 1000)).is_none());
        assert!(connections.admit(client([10, 0, 0, 2], 2)).is_some());
        drop((greedy, busy));
    }
}
