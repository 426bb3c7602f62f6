//! Primary, secondary and real-time interface: script text in, robot state out.

use super::outbox::{Outbox, lock};
use super::{Shared, read_all};
use crate::controller::Script;
use std::io::{ErrorKind, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Longest script, bytes.
const MAX_SCRIPT: usize = 1 << 20;
/// Scripts that may wait for the lab's loop.
const MAX_WAITING: usize = 16;

/// Which of the three.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Port {
    Primary,
    Secondary,
    Realtime,
}

/// One client of a state stream as the lab's loop sees it.
pub(super) struct StreamClient {
    pub(super) id: u64,
    pub(super) port: Port,
    pub(super) outbox: Arc<Outbox>,
    /// Whether it has had the version message.
    pub(super) greeted: bool,
}

/// Cuts received text into programs: a `def` or `sec` with everything up to its `end`, or a single
/// line, which is a program of its own.
#[derive(Debug, Default)]
struct Assembler {
    line: Vec<u8>,
    program: String,
    depth: usize,
}

impl Assembler {
    fn push(
        &mut self,
        bytes: &[u8],
        mut take: impl FnMut(String) -> Result<(), String>,
    ) -> Result<(), String> {
        for part in bytes.split_inclusive(|b| *b == b'\n') {
            self.line.extend_from_slice(part);
            if self.line.len() + self.program.len() > MAX_SCRIPT {
                return Err(format!("a script of more than {MAX_SCRIPT} bytes"));
            }
            if !part.ends_with(b"\n") {
                continue;
            }
            let line = std::mem::take(&mut self.line);
            let line = String::from_utf8(line).map_err(|_| "a script that is not UTF-8")?;
            if let Some(program) = self.line(&line) {
                take(program)?;
            }
        }
        Ok(())
    }

    fn line(&mut self, line: &str) -> Option<String> {
        let words = words(line);
        if self.program.is_empty() && words.is_empty() {
            return None;
        }
        let opens = words.first().is_some_and(|w| {
            matches!(w.as_str(), "def" | "sec" | "thread" | "if" | "while" | "for" | "struct")
        });
        let single = self.program.is_empty() && !opens;
        if single {
            return Some(format!("def unnamed():\n{line}end\n"));
        }
        self.program.push_str(line);
        let ends = words.iter().filter(|w| *w == "end").count();
        self.depth = (self.depth + usize::from(opens)).saturating_sub(ends);
        (self.depth == 0).then(|| std::mem::take(&mut self.program))
    }
}

/// Words of a line outside comments and texts.
fn words(line: &str) -> Vec<String> {
    let mut out = vec![String::new()];
    let mut quote = None;
    for c in line.chars() {
        match quote {
            Some(q) if c == q => quote = None,
            Some(_) => {}
            None if c == '#' => break,
            None if c == '"' || c == '\'' => quote = Some(c),
            None if c.is_alphanumeric() || c == '_' => {
                if let Some(last) = out.last_mut() {
                    last.push(c);
                }
            }
            None if c.is_whitespace() => out.push(String::new()),
            // Anything else parts words, and counts as one itself.
            None => out.extend([c.to_string(), String::new()]),
        }
    }
    out.retain(|w| !w.is_empty());
    out
}

/// Writes whole messages to a client that may never read them: those who only send scripts do not.
/// It misses messages then, but keeps its connection.
fn write_patiently(mut stream: TcpStream, outbox: &Outbox) {
    // The one that reads ends the connection; a time-out lets this one see that.
    let _ = stream.set_write_timeout(Some(Duration::from_millis(200)));
    while let Some(bytes) = outbox.next() {
        let mut rest = &bytes[..];
        while !rest.is_empty() && !outbox.closed() {
            match stream.write(rest) {
                Ok(0) => return,
                Ok(n) => rest = &rest[n..],
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => {
                    let _ = stream.shutdown(Shutdown::Both);
                    return;
                }
            }
        }
    }
}

/// Serves one client.
pub(super) fn serve(mut stream: TcpStream, shared: &Arc<Shared>, port: Port) {
    let id = shared.next_id.fetch_add(1, Ordering::Relaxed);
    let outbox = Arc::new(Outbox::default());
    let Ok(out) = stream.try_clone() else { return };
    let writer = {
        let outbox = Arc::clone(&outbox);
        std::thread::spawn(move || write_patiently(out, &outbox))
    };
    let client = StreamClient { id, port, outbox: Arc::clone(&outbox), greeted: false };
    lock(&shared.streams).push(client);
    let mut assembler = Assembler::default();
    let take = |text: String| {
        // Reading the text is left to this thread: the lab's loop has no time for it.
        let script = Script::parse(&text);
        let mut scripts = lock(&shared.scripts);
        if scripts.len() >= MAX_WAITING {
            return Err("more scripts than the controller can take".to_owned());
        }
        scripts.push(script);
        Ok(())
    };
    let mut end = read_all(&mut stream, shared, |bytes| assembler.push(bytes, take));
    if end.is_ok() && !assembler.line.is_empty() {
        end = assembler.push(b"\n", take);
    }
    if let Err(reason) = end {
        tracing::warn!("script client {id} disconnected: {reason}");
    }
    lock(&shared.streams).retain(|c| c.id != id);
    outbox.close();
    // Both may fail when the peer went first; the socket is gone either way.
    let _ = stream.shutdown(Shutdown::Both);
    let _ = writer.join();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(text: &str, size: usize) -> Vec<String> {
        let (mut a, mut got) = (Assembler::default(), Vec::new());
        for chunk in text.as_bytes().chunks(size) {
            a.push(chunk, |p| {
                got.push(p);
                Ok(())
            })
            .unwrap();
        }
        got
    }

    #[test]
    fn programs_survive_any_cut() {
        let one = "def a():\n  # the end\n  if x == \"end\":\n    y = 1\n  elif z:\n  end\nend\n";
        let two = "sec b():\n  while True:\n    sync()\n  end\nend\n";
        let text = format!("{one}\n\n{two}movej([0,0,0,0,0,0])\n");
        for size in [1, 2, 7, 100, 1000] {
            let got = cut(&text, size);
            assert_eq!(got.len(), 3, "{got:?}");
            assert_eq!((got[0].as_str(), got[1].as_str()), (one, two));
            assert_eq!(got[2], "def unnamed():\nmovej([0,0,0,0,0,0])\nend\n");
        }
    }

    #[test]
    fn floods_and_noise_are_refused() {
        let mut a = Assembler::default();
        assert!(a.push(&[b'x'; MAX_SCRIPT + 1], |_| Ok(())).is_err());
        let mut a = Assembler::default();
        assert!(a.push(&[0xff, 0xfe, b'\n'], |_| Ok(())).is_err());
    }
}
