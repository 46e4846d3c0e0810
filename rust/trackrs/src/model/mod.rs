//! How targets move and how sensors see them: the traits [`Motion`] and [`Sensor`] and the models that implement them.

pub mod motion;
pub mod numeric;
pub mod rotation;
pub mod sensor;
pub mod space;

pub use motion::{Motion, MotionModel, NoiseInput};
pub use rotation::Rotation;
pub use sensor::{Sensor, SensorModel};
pub use space::StateSpace;
