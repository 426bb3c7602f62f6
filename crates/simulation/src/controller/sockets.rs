//! The sockets that a script opens. Each has its own threads; the controller never waits for them.

use std::collections::{BTreeMap, VecDeque};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Sockets at one time.
const MAX_SOCKETS: usize = 16;
/// Received bytes that wait for the script; the peer is left waiting beyond.
const MAX_WAITING: usize = 1 << 16;
/// Messages that wait to be sent.
const MAX_SENDING: usize = 256;
const CONNECT: Duration = Duration::from_secs(2);
const LOOK: Duration = Duration::from_millis(50);

/// How a socket is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum SocketState {
    /// Not connected yet.
    #[default]
    Connecting,
    /// Connected.
    Open,
    /// Refused, or closed by the peer.
    Closed,
}

#[derive(Debug, Default)]
struct Shared {
    state: SocketState,
    received: VecDeque<u8>,
    /// The script has closed it.
    dropped: bool,
}

#[derive(Debug)]
struct Socket {
    shared: Arc<Mutex<Shared>>,
    send: SyncSender<Vec<u8>>,
}

impl Drop for Socket {
    fn drop(&mut self) {
        lock(&self.shared).dropped = true;
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A program's sockets by name.
#[derive(Debug, Default)]
pub(crate) struct ScriptSockets(BTreeMap<String, Socket>);

impl ScriptSockets {
    /// Begins to connect; false when too many are open.
    pub(crate) fn open(&mut self, name: &str, host: &str, port: u16) -> bool {
        self.0.remove(name);
        if self.0.len() >= MAX_SOCKETS {
            return false;
        }
        let shared = Arc::new(Mutex::new(Shared::default()));
        let (send, queue) = sync_channel(MAX_SENDING);
        let (host, theirs) = (host.to_owned(), Arc::clone(&shared));
        std::thread::spawn(move || {
            match connect(&host, port) {
                Some(stream) => serve(stream, &theirs, queue),
                None => tracing::debug!("a script's socket to {host}:{port} does not connect"),
            }
            lock(&theirs).state = SocketState::Closed;
        });
        self.0.insert(name.to_owned(), Socket { shared, send });
        true
    }

    /// How a socket is; an unknown one is closed.
    pub(crate) fn state(&self, name: &str) -> SocketState {
        self.0.get(name).map_or(SocketState::Closed, |s| lock(&s.shared).state)
    }

    /// Queues bytes; false when there is no connection or the peer does not read.
    pub(crate) fn send(&self, name: &str, bytes: Vec<u8>) -> bool {
        let Some(s) = self.0.get(name) else { return false };
        lock(&s.shared).state == SocketState::Open && s.send.try_send(bytes).is_ok()
    }

    /// Exactly `n` received bytes, or `None` as long as there are less.
    pub(crate) fn take(&self, name: &str, n: usize) -> Option<Vec<u8>> {
        let mut s = lock(&self.0.get(name)?.shared);
        (s.received.len() >= n).then(|| s.received.drain(..n).collect())
    }

    /// All received bytes up to and with the first `end` for which `ends` holds of what came so far.
    pub(crate) fn take_until(&self, name: &str, ends: impl Fn(&[u8]) -> bool) -> Option<Vec<u8>> {
        let mut s = lock(&self.0.get(name)?.shared);
        let bytes: Vec<u8> = s.received.iter().copied().collect();
        let n = (1..=bytes.len()).find(|n| ends(&bytes[..*n]))?;
        Some(s.received.drain(..n).collect())
    }

    /// How many bytes wait.
    pub(crate) fn waiting(&self, name: &str) -> usize {
        self.0.get(name).map_or(0, |s| lock(&s.shared).received.len())
    }

    /// Closes one.
    pub(crate) fn close(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// Closes all.
    pub(crate) fn close_all(&mut self) {
        self.0.clear();
    }
}

fn connect(host: &str, port: u16) -> Option<TcpStream> {
    let addresses = (host, port).to_socket_addrs().ok()?;
    let stream =
        addresses.into_iter().find_map(|a| TcpStream::connect_timeout(&a, CONNECT).ok())?;
    stream.set_nodelay(true).ok()?;
    stream.set_read_timeout(Some(LOOK)).ok()?;
    stream.set_write_timeout(Some(CONNECT)).ok()?;
    Some(stream)
}

fn serve(mut stream: TcpStream, shared: &Arc<Mutex<Shared>>, queue: Receiver<Vec<u8>>) {
    let Ok(mut out) = stream.try_clone() else { return };
    let theirs = Arc::clone(shared);
    let writer = std::thread::spawn(move || {
        loop {
            match queue.recv_timeout(LOOK) {
                Ok(bytes) if out.write_all(&bytes).is_ok() => {}
                // What a script sent before it closed is still written.
                Err(RecvTimeoutError::Timeout) if lock(&theirs).state == SocketState::Open => {}
                _ => break,
            }
        }
        let _ = out.shutdown(Shutdown::Both);
    });
    lock(shared).state = SocketState::Open;
    let mut buffer = [0_u8; 4096];
    loop {
        {
            let s = lock(shared);
            if s.dropped {
                break;
            }
            if s.received.len() >= MAX_WAITING {
                drop(s);
                std::thread::sleep(LOOK);
                continue;
            }
        }
        match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => lock(shared).received.extend(&buffer[..n]),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
    lock(shared).state = SocketState::Closed;
    // A writer that panicked has nothing left to clean up.
    let _ = writer.join();
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn wait(mut done: impl FnMut() -> bool) {
        for _ in 0..500 {
            if done() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("it does not happen");
    }

    #[test]
    fn talks_and_never_waits() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let mut s = ScriptSockets::default();
        assert!(!s.send("a", b"x".to_vec()));
        assert!(s.open("a", "127.0.0.1", port));
        let (mut peer, _) = listener.accept().unwrap();
        wait(|| s.state("a") == SocketState::Open);
        assert!(s.send("a", b"hello\n".to_vec()));
        let mut got = [0; 6];
        peer.read_exact(&mut got).unwrap();
        assert_eq!(&got, b"hello\n");
        peer.write_all(b"(1,2)\nrest").unwrap();
        wait(|| s.waiting("a") == 10);
        assert_eq!(s.take_until("a", |b| b.ends_with(b"\n")).unwrap(), b"(1,2)\n");
        assert_eq!(s.take("a", 5), None);
        assert_eq!(s.take("a", 4).unwrap(), b"rest");
        s.close("a");
        wait(|| matches!(peer.read(&mut got), Ok(0)));
        drop(listener);
        assert!(s.open("b", "127.0.0.1", port));
        wait(|| s.state("b") == SocketState::Closed);
    }
}
