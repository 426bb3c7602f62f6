//! A small interpreter for the TFLite networks of the hand chain.
//!
//! It reads a `.tflite` file ([`Network::load`]), checks every shape once, and then runs the
//! operators one after the other on the calling thread. Only what the palm and landmark networks
//! need is there: float32 activations, float32 or float16 constants, NHWC. Anything else is a
//! typed error at load time, which names the operator or the tensor.

mod convolution;
mod error;
mod executor;
mod flatbuffer;
mod kernels;
mod model;
mod plan;
mod window;

pub use error::NetworkError;
pub use executor::Network;
