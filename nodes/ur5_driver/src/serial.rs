//! A serial line: 115200 baud, 8 data bits, no parity, one stop bit, raw bytes.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read as _, Result, Write as _};
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::OpenOptionsExt as _;

/// Most bytes that one read takes.
const CHUNK: usize = 256;
/// A read waits this long (ms) for the first byte.
const WAIT: i32 = 20;

/// An open serial line.
pub struct Serial {
    file: File,
}

impl Serial {
    /// Opens a device such as `/dev/ttyUSB0`.
    pub fn open(device: &str) -> Result<Self> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(device)?;
        // SAFETY: an all-zero termios is a valid value, and it is filled by tcgetattr before it is read;
        // the descriptor belongs to `file`, which outlives the calls.
        unsafe {
            let fd = file.as_raw_fd();
            let mut settings: libc::termios = std::mem::zeroed();
            check(libc::tcgetattr(fd, &raw mut settings))?;
            libc::cfmakeraw(&raw mut settings);
            settings.c_cflag |= libc::CLOCAL | libc::CREAD;
            settings.c_cflag &= !(libc::CSTOPB | libc::CRTSCTS);
            check(libc::cfsetspeed(&raw mut settings, libc::B115200))?;
            check(libc::tcsetattr(fd, libc::TCSANOW, &raw const settings))?;
        }
        Ok(Self { file })
    }

    /// Throws away what was received and not read.
    pub fn discard(&mut self) -> Result<()> {
        // SAFETY: the descriptor belongs to `self.file`.
        check(unsafe { libc::tcflush(self.file.as_raw_fd(), libc::TCIFLUSH) })
    }

    pub fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        // A frame is far smaller than the line's buffer, so that a full one means a dead line.
        self.file.write_all(bytes)
    }

    /// Adds what has come to `out`, after a short wait; how much it was.
    pub fn read_some(&mut self, out: &mut Vec<u8>) -> Result<usize> {
        let mut slot = libc::pollfd { fd: self.file.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: `slot` is one valid entry, and the descriptor belongs to `self.file`.
        check(unsafe { libc::poll(&raw mut slot, 1, WAIT) })?;
        let mut buffer = [0_u8; CHUNK];
        match self.file.read(&mut buffer) {
            Ok(0) if slot.revents & (libc::POLLHUP | libc::POLLERR) != 0 => {
                Err(Error::new(ErrorKind::BrokenPipe, "the serial device has gone"))
            }
            Ok(n) => {
                out.extend_from_slice(&buffer[..n]);
                Ok(n)
            }
            Err(e) if e.kind() == ErrorKind::WouldBlock => Ok(0),
            Err(e) => Err(e),
        }
    }
}

fn check(code: i32) -> Result<()> {
    if code < 0 {
        let error = Error::last_os_error();
        // A signal that interrupts the wait is as good as its end.
        return if error.kind() == ErrorKind::Interrupted { Ok(()) } else { Err(error) };
    }
    Ok(())
}
