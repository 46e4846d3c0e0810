//! Local tangent frames about an origin: north-east-down and east-north-up.
//!
//! | symbol | name here                  | shape | meaning                                                |
//! |--------|----------------------------|-------|--------------------------------------------------------|
//! | φ, λ   | `origin`                   |       | latitude and longitude of the origin                   |
//! | o      | `origin_ecef`              | 3     | the origin in ECEF coordinates                         |
//! | R      | [`LocalFrame::rotation`]   | 3×3   | rows: the local axes in ECEF                           |
//! | X, p   | ECEF and local coordinates | 3     | metres                                                 |
//! | C, P   | their covariances          | 3×3   |                                                        |
//!
//! north = (−sin φ cos λ, −sin φ sin λ, cos φ),  east = (−sin λ, cos λ, 0),  up = (cos φ cos λ, cos φ sin λ, sin φ)
//! R = [north; east; −up] or [east; north; up];  p = R (X − o),  X = o + Rᵀ p,  P = R C Rᵀ,  C = Rᵀ P R
//!
//! Cartesian, so neither the antimeridian nor a pole is a seam. "Down" is depth below the tangent plane at the origin:
//! d metres away the sea surface lies d²/2a deeper (8 m at 10 km).
//! Reference: Groves (2013), Principles of GNSS, inertial, and multisensor integrated navigation systems, §2.4, (2.150).

use nalgebra::{Matrix3, Vector3};

use super::wgs84::Geodetic;
use crate::error::Result;

/// Which way the axes of a local frame point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axes {
    /// North, east, down.
    Ned,
    /// East, north, up.
    Enu,
}

/// A Cartesian frame that touches the Earth at its origin; coordinates in metres.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalFrame {
    origin: Geodetic,
    origin_ecef: Vector3<f64>,
    rotation: Matrix3<f64>,
}

impl LocalFrame {
    /// The frame about this origin.
    pub fn new(origin: Geodetic, axes: Axes) -> Result<Self> {
        let origin = Geodetic::new(origin.lat, origin.lon, origin.height)?;
        let (sin_lat, cos_lat) = (libm::sin(origin.lat), libm::cos(origin.lat));
        let (sin_lon, cos_lon) = (libm::sin(origin.lon), libm::cos(origin.lon));
        let north = Vector3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat).transpose();
        let east = Vector3::new(-sin_lon, cos_lon, 0.0).transpose();
        let up = Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat).transpose();
        let rotation = match axes {
            Axes::Ned => Matrix3::from_rows(&[north, east, -up]),
            Axes::Enu => Matrix3::from_rows(&[east, north, up]),
        };
        Ok(Self {
            origin,
            origin_ecef: origin.to_ecef(),
            rotation,
        })
    }

    /// The origin.
    pub fn origin(&self) -> Geodetic {
        self.origin
    }

    /// R: turns ECEF differences into local ones. Its rows are the local axes.
    pub fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// Local coordinates of an ECEF point.
    pub fn from_ecef(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * (point - self.origin_ecef)
    }

    /// ECEF coordinates of a local point.
    pub fn to_ecef(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.origin_ecef + self.rotation.transpose() * point
    }

    /// Local coordinates of a geodetic position.
    pub fn from_geodetic(&self, position: &Geodetic) -> Vector3<f64> {
        self.from_ecef(&position.to_ecef())
    }

    /// The geodetic position of a local point.
    pub fn to_geodetic(&self, point: &Vector3<f64>) -> Result<Geodetic> {
        Geodetic::from_ecef(&self.to_ecef(point))
    }

    /// The covariance of local coordinates from that of ECEF ones.
    pub fn cov_from_ecef(&self, cov: &Matrix3<f64>) -> Matrix3<f64> {
        turned(&self.rotation, cov)
    }

    /// The covariance of ECEF coordinates from that of local ones.
    pub fn cov_to_ecef(&self, cov: &Matrix3<f64>) -> Matrix3<f64> {
        turned(&self.rotation.transpose(), cov)
    }
}

/// A C Aᵀ, symmetric bit for bit.
pub(super) fn turned(matrix: &Matrix3<f64>, cov: &Matrix3<f64>) -> Matrix3<f64> {
    let out = matrix * cov * matrix.transpose();
    (out + out.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(lat: f64, lon: f64, axes: Axes) -> LocalFrame {
        LocalFrame::new(Geodetic { lat, lon, height: 30.0 }, axes).unwrap()
    }

    #[test]
    fn up_is_up_and_north_is_north() {
        let origin = Geodetic::new(0.7, -2.0, 30.0).unwrap();
        let ned = LocalFrame::new(origin, Axes::Ned).unwrap();
        let above = ned.from_geodetic(&Geodetic {
            height: 130.0,
            ..origin
        });
        assert!((above - Vector3::new(0.0, 0.0, -100.0)).norm() < 1e-8);
        let north = ned.from_geodetic(&Geodetic {
            lat: 0.7 + 1e-6,
            ..origin
        });
        assert!(north.x > 6.0 && north.y.abs() < 1e-6 && north.z.abs() < 1e-3);
        let enu = LocalFrame::new(origin, Axes::Enu).unwrap();
        let east = enu.from_geodetic(&Geodetic {
            lon: -2.0 + 1e-6,
            ..origin
        });
        assert!(east.x > 4.0 && east.y.abs() < 1e-3 && east.z.abs() < 1e-3);
    }

    #[test]
    fn covariance_goes_there_and_back() {
        let cov = Matrix3::new(4.0, 1.0, 0.2, 1.0, 9.0, -0.4, 0.2, -0.4, 1.0);
        let frame = frame(-0.4, 3.0, Axes::Enu);
        let there = frame.cov_from_ecef(&cov);
        assert!((there.trace() - cov.trace()).abs() < 1e-12);
        assert!((frame.cov_to_ecef(&there) - cov).amax() < 1e-12);
        assert_eq!(there, there.transpose());
    }

    #[test]
    fn an_origin_in_degrees_is_refused() {
        let origin = Geodetic {
            lat: 54.0,
            lon: 10.0,
            height: 0.0,
        };
        assert!(
            LocalFrame::new(origin, Axes::Ned)
                .unwrap_err()
                .to_string()
                .contains("radians")
        );
    }
}
