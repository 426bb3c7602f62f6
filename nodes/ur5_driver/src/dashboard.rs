//! The connection to the dashboard server: made when somebody asks, kept while it works.

use anyhow::{Context as _, bail};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tdv_ur_protocol::dashboard::{Answer, GREETING, Request};
use tdv_ur_protocol::gripper::LineReader;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::Mutex;
use tokio::time::timeout;

/// Time to connect, and for each answer.
const PATIENCE: Duration = Duration::from_secs(2);

struct Link {
    socket: TcpStream,
    lines: LineReader,
}

/// A client of the dashboard server; clones share the connection.
#[derive(Clone)]
pub struct Dashboard {
    address: SocketAddr,
    link: Arc<Mutex<Option<Link>>>,
}

impl Dashboard {
    pub fn new(address: SocketAddr) -> Self {
        Self { address, link: Arc::default() }
    }

    /// Sends a command; what the answer says, and its words.
    pub async fn ask(&self, request: &Request) -> anyhow::Result<(Answer, String)> {
        let line = request.to_line()?;
        let mut slot = self.link.lock().await;
        // A connection that the server has closed meanwhile shows only when it is used: once more then.
        let fresh = slot.is_none();
        let words = match self.exchange(&mut slot, &line).await {
            Ok(words) => words,
            Err(error) if fresh => return Err(error),
            Err(_) => self.exchange(&mut slot, &line).await?,
        };
        if *request == Request::Quit {
            *slot = None;
        }
        Ok((request.answer(&words), words))
    }

    /// Connects anew.
    pub async fn connect(&self) -> anyhow::Result<()> {
        let mut slot = self.link.lock().await;
        *slot = None;
        *slot = Some(self.open().await?);
        Ok(())
    }

    async fn exchange(&self, slot: &mut Option<Link>, line: &str) -> anyhow::Result<String> {
        let mut link = match slot.take() {
            Some(link) => link,
            None => self.open().await?,
        };
        let words = timeout(PATIENCE, async {
            link.socket.write_all(line.as_bytes()).await?;
            link.next_line().await
        })
        .await
        .with_context(|| format!("the dashboard server did not answer to {:?}", line.trim()))??;
        // Only a connection that has worked to the end is kept.
        *slot = Some(link);
        Ok(words)
    }

    async fn open(&self) -> anyhow::Result<Link> {
        let connected = timeout(PATIENCE, TcpStream::connect(self.address)).await;
        let socket = connected
            .map_err(|_| std::io::Error::from(std::io::ErrorKind::TimedOut))
            .flatten()
            .with_context(|| format!("no dashboard server at {}", self.address))?;
        let mut link = Link { socket, lines: LineReader::default() };
        let greeting = timeout(PATIENCE, link.next_line())
            .await
            .context("the dashboard server does not greet")??;
        if !greeting.starts_with(GREETING) {
            bail!("{:?} is not the greeting of a dashboard server", greeting);
        }
        Ok(link)
    }
}

impl Link {
    async fn next_line(&mut self) -> anyhow::Result<String> {
        let mut buffer = [0_u8; 256];
        loop {
            if let Some(line) = self.lines.next_line() {
                return Ok(line);
            }
            match self.socket.read(&mut buffer).await? {
                0 => bail!("the dashboard server closed the connection"),
                n => self.lines.push(&buffer[..n])?,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    #[tokio::test]
    async fn a_closed_connection_is_opened_again() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let dashboard = Dashboard::new(listener.local_addr().unwrap());
        let server = tokio::spawn(async move {
            for answer in ["Robotmode: IDLE\n", "Powering on\n"] {
                let (mut socket, _) = listener.accept().await.unwrap();
                socket.write_all(format!("{GREETING}\n").as_bytes()).await.unwrap();
                let mut buffer = [0; 64];
                let n = socket.read(&mut buffer).await.unwrap();
                assert!(n > 0);
                socket.write_all(answer.as_bytes()).await.unwrap();
            }
        });
        let (answer, _) = dashboard.ask(&Request::RobotMode).await.unwrap();
        assert_eq!(answer, Answer::RobotMode(5));
        // The server has gone in between.
        let (answer, words) = dashboard.ask(&Request::PowerOn).await.unwrap();
        assert_eq!((answer, words.as_str()), (Answer::Done, "Powering on"));
        server.await.unwrap();
        assert!(dashboard.ask(&Request::PowerOn).await.is_err());
        assert!(dashboard.ask(&Request::Popup("a\nb".into())).await.is_err());
    }
}
