//! Files written whole or not at all, and the hash that names their content.

use crate::DemonstrationError;
use std::fs;
use std::io::Write;
use std::path::Path;

/// Writes to a temporary name beside `path`, then renames: a reader never sees half a file.
pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), DemonstrationError> {
    let io = |source| DemonstrationError::Io { path: path.to_path_buf(), source };
    if let Some(dir) = path.parent().filter(|d| !d.as_os_str().is_empty()) {
        fs::create_dir_all(dir).map_err(io)?;
    }
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.tmp", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = (|| {
        let mut f = fs::File::create(&temporary)?;
        f.write_all(bytes)?;
        f.sync_all()?;
        fs::rename(&temporary, path)
    })();
    if written.is_err() {
        // The first error is the one worth reporting.
        let _ = fs::remove_file(&temporary);
    }
    written.map_err(io)
}

pub(crate) fn read(path: &Path) -> Result<String, DemonstrationError> {
    fs::read_to_string(path)
        .map_err(|source| DemonstrationError::Io { path: path.to_path_buf(), source })
}

/// FNV-1a, 64 bit: an identity for reports and checkpoints, not a protection.
#[derive(Clone)]
pub(crate) struct Fnv(u64);

impl Fnv {
    pub(crate) fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        for b in bytes {
            self.0 = (self.0 ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.bytes(&(text.len() as u64).to_le_bytes());
        self.bytes(text.as_bytes());
    }

    pub(crate) fn number(&mut self, x: f64) {
        self.bytes(&x.to_bits().to_le_bytes());
    }

    pub(crate) fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_hash_and_no_leftovers() {
        let mut h = Fnv::new();
        h.bytes(b"a");
        assert_eq!(h.hex(), "af63dc4c8601ec8c");
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("sub/x.json");
        write_atomically(&path, b"{}").unwrap();
        write_atomically(&path, b"[]").unwrap();
        assert_eq!(read(&path).unwrap(), "[]");
        assert_eq!(fs::read_dir(dir.path().join("sub")).unwrap().count(), 1);
        assert!(matches!(write_atomically(dir.path(), b"x"), Err(DemonstrationError::Io { .. })));
    }
}
