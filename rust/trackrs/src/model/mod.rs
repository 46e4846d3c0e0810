//! How targets move and how sensors see them: the traits [`Motion`] and [`Sensor`] and the models that implement them.

pub mod motion;
pub mod numeric;
pub mod sensor;

pub use motion::{Motion, MotionModel, NoiseInput};
pub use sensor::{Sensor, SensorModel};
