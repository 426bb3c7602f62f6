//! What goes into the text-and-image networks and what their outputs mean; no network runs here.

pub mod boxes;
pub mod image;
pub mod masks;
pub mod phrases;
pub mod wordpiece;
