//! Telling other participants that this one has gone.
//!
//! RustDDS disposes its participant, but in a form that Fast DDS (rclpy, `ros2`) does not take for the
//! end of it: there the topics would stay listed until the lease runs out. This sends the notice as the
//! RTPS specification (OMG DDSI-RTPS 2.3, 8.5.3.3 and 9.6.3.9) has it: a DATA message of the built-in
//! participant writer, its key the participant's GUID, status disposed and unregistered.

use crate::context::{DiscoveryRange, Environment};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};

/// Where participants of a domain listen for each other (RTPS 9.6.1.1).
const MULTICAST: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// Participants of one machine that are told directly.
const PARTICIPANTS: u16 = 40;

/// The notice that the participant with this GUID (16 bytes) has gone.
fn notice(guid: &[u8; 16]) -> Vec<u8> {
    let mut m = Vec::with_capacity(128);
    m.extend(b"RTPS");
    m.extend([2, 3]); // protocol version
    m.extend([1, 18]); // vendor: RustDDS
    m.extend(&guid[..12]);
    // DATA: little endian, inline QoS, serialized key.
    let flags = 0x01 | 0x02 | 0x08;
    let mut data = Vec::with_capacity(96);
    data.extend([0, 0]); // extra flags
    data.extend(16_u16.to_le_bytes()); // from here to the inline QoS
    data.extend([0x00, 0x01, 0x00, 0xc7]); // reader: built-in participant reader
    data.extend([0x00, 0x01, 0x00, 0xc2]); // writer: built-in participant writer
    // Later than all that this writer has sent.
    data.extend(0_i32.to_le_bytes());
    data.extend(0x7fff_0000_u32.to_le_bytes());
    parameter(&mut data, 0x0070, guid); // key hash
    parameter(&mut data, 0x0071, &[0, 0, 0, 3]); // status: disposed, unregistered
    parameter(&mut data, 0x0001, &[]);
    data.extend([0x00, 0x03, 0, 0]); // parameter list, little endian
    parameter(&mut data, 0x0050, guid); // participant GUID
    parameter(&mut data, 0x0001, &[]);
    m.extend([0x15, flags]);
    m.extend((data.len() as u16).to_le_bytes());
    m.extend(data);
    m
}

fn parameter(out: &mut Vec<u8>, id: u16, value: &[u8]) {
    out.extend(id.to_le_bytes());
    out.extend((value.len() as u16).to_le_bytes());
    out.extend(value);
}

/// Sends the notice to the domain. Best effort: nobody answers, and who misses it waits for the lease.
pub(crate) fn say(environment: Environment, guid: &[u8; 16]) {
    let local = environment.range == DiscoveryRange::Localhost;
    let from = if local { Ipv4Addr::LOCALHOST } else { Ipv4Addr::UNSPECIFIED };
    let Ok(socket) = UdpSocket::bind((from, 0)) else { return };
    let message = notice(guid);
    // Ports by the specification's formula; a domain above 232 has been refused.
    let base = 7400 + 250 * environment.domain;
    let mut to: Vec<SocketAddr> = vec![(MULTICAST, base).into()];
    to.extend(
        (0..PARTICIPANTS).map(|i| SocketAddr::from((Ipv4Addr::LOCALHOST, base + 10 + 2 * i))),
    );
    for address in to {
        let _ = socket.send_to(&message, address);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_notice_has_the_lengths_it_says() {
        let guid: [u8; 16] = std::array::from_fn(|i| i as u8);
        let m = notice(&guid);
        assert_eq!(&m[..4], b"RTPS");
        assert_eq!(&m[8..20], &guid[..12]);
        let length = u16::from_le_bytes([m[22], m[23]]) as usize;
        assert_eq!(24 + length, m.len());
        // Inline QoS begins 16 bytes after its offset field.
        assert_eq!(&m[28 + 16..28 + 18], &0x0070_u16.to_le_bytes());
        assert_eq!(m.len() % 4, 0);
    }
}
