//! Tests across nodes: processes over DDS on this machine alone, judged by what they publish and leave.

#![allow(clippy::unwrap_used)]

mod faults;
mod lockstep;
mod peers;
mod trouble;
