use super::outbox::{Outbox, lock};
use super::session::Session;
use super::{Link, RtdeClient, Shared, read_all};
use std::io::Write;
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Instant;
use tdv_ur_protocol::rtde::{ClientPackage, FrameReader};

/// Serves one RTDE client until it leaves or misbehaves.
pub(super) fn serve(mut stream: TcpStream, shared: &Arc<Shared>) {
    if shared.is_cut(Link::Rtde) {
        return;
    }
    let id = shared.next_id.fetch_add(1, Ordering::Relaxed);
    let session = Session::new(id, shared.generation.version(), shared.fastest());
    let session = Arc::new(Mutex::new(session));
    let outbox = Arc::new(Outbox::default());
    let Ok(out) = stream.try_clone() else { return };
    let writer = {
        let outbox = Arc::clone(&outbox);
        std::thread::spawn(move || write_all(out, &outbox))
    };
    lock(&shared.clients).push(RtdeClient {
        id,
        session: Arc::clone(&session),
        outbox: Arc::clone(&outbox),
    });

    let mut frames = FrameReader::default();
    let end = read_all(&mut stream, shared, |bytes| {
        if shared.is_cut(Link::Rtde) {
            return Err("the connection is cut".into());
        }
        frames.push(bytes);
        while let Some(frame) = frames.next_frame().map_err(|e| e.to_string())? {
            let package = ClientPackage::parse(frame).map_err(|e| e.to_string())?;
            let data = matches!(package, ClientPackage::Data(_));
            let mut registers = lock(&shared.registers);
            let answers = lock(&session)
                .handle(package, &mut lock(&shared.owners), &mut registers)
                .map_err(|e| e.to_string())?;
            if data {
                lock(&shared.meter).arrived(registers.inputs(), Instant::now());
            }
            drop(registers);
            for answer in answers {
                if !outbox.answer(answer.to_bytes()) {
                    return Err("it does not read its answers".into());
                }
            }
        }
        Ok(())
    });
    if let Err(reason) = end {
        tracing::warn!("RTDE client {id} disconnected: {reason}");
    }
    lock(&shared.clients).retain(|c| c.id != id);
    lock(&shared.owners).retain(|_, owner| *owner != id);
    outbox.close();
    // Both may fail when the peer went first; the socket is gone either way.
    let _ = stream.shutdown(Shutdown::Both);
    let _ = writer.join();
}

fn write_all(mut stream: TcpStream, outbox: &Outbox) {
    while let Some(bytes) = outbox.next() {
        if stream.write_all(&bytes).is_err() {
            // The reader sees the closed socket and cleans up.
            let _ = stream.shutdown(Shutdown::Both);
            return;
        }
    }
}
