//! Geodetic coordinates on the WGS-84 ellipsoid and Earth-centred, Earth-fixed (ECEF) coordinates.
//!
//! | symbol  | name here        | meaning                                                     |
//! |---------|------------------|-------------------------------------------------------------|
//! | φ, λ, h | [`Geodetic`]     | latitude, longitude (radians), height over the ellipsoid (m) |
//! | x, y, z | `Vector3`        | ECEF coordinates, metres; z to the north pole, x to φ = λ = 0 |
//! | a, e²   | constants below  | semi-major axis, first eccentricity squared, e² = f (2 − f) |
//! | N       | `normal`         | radius of curvature in the prime vertical                   |
//!
//! forward:  N = a / √(1 − e² sin²φ),  x = (N + h) cos φ cos λ,  y = (N + h) cos φ sin λ,  z = ((1 − e²) N + h) sin φ
//! inverse:  ρ² = x² + y²,  p = ρ²/a²,  q = (1 − e²) z²/a²,  r = (p + q − e⁴)/6,  d = 8r³ + e⁴pq
//!   d > 0 (outside the evolute):  c = (√d + √(e⁴pq))²,  u = r + ½ c^⅓ + 2 r² c^(−⅓)
//!   d ≤ 0, z ≠ 0 (inside):        t = ⅔ atan( √(e⁴pq) / (√−d + √(−8r³)) ),  u = −4 r sin t cos(π/6 + t)
//!   v = √(u² + e⁴q),  w = e² (u + v − q)/(2v),  k = (u + v)/(√(w² + u + v) + w),  D = kρ/(k + e²)
//!   φ = atan(z/D),  h = (k + e² − 1)/k √(D² + z²)
//!   z = 0, p ≤ e⁴ (the disc about the centre): tan φ = √(e⁴ − p) / (√(1 − e²) √p),  h = −a √(1 − e²) √(e² − p)/e
//!
//! Closed form, valid in all space. Inside the evolute (within 43 km of the Earth's centre) several geodetic
//! coordinates name one point; this is the one of the nearest surface point, on the northern side where z = 0.
//! References: NIMA TR8350.2 (2000), tables 3.1 and 3.3; Vermeille (2011), An analytical method to transform
//! geocentric into geodetic coordinates, J. Geod. 85, 105-117.
//! Deviations: angles by atan2 (the half-angle formulas are equal, without their branches); on the Earth's axis the
//! longitude is 0.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, TAU};

use nalgebra::Vector3;

use crate::error::{Error, Result, require_finite};

/// Semi-major axis a, metres.
pub const SEMI_MAJOR_AXIS: f64 = 6_378_137.0;
/// Flattening f.
pub const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared, e² = f (2 − f).
pub const ECCENTRICITY_SQUARED: f64 = FLATTENING * (2.0 - FLATTENING);

/// Heights and coordinates beyond this (a tenth of a light-year) are taken for a mistake, metres.
const FARTHEST: f64 = 1e15;

/// A position by latitude, longitude and height over the WGS-84 ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geodetic {
    /// Latitude, radians, in [−π/2, π/2].
    pub lat: f64,
    /// Longitude, radians, positive to the east; results lie in [−π, π].
    pub lon: f64,
    /// Height over the ellipsoid, metres.
    pub height: f64,
}

impl Geodetic {
    /// Checked: latitude in ±π/2, longitude in ±2π (both conventions, ±π and 0..2π, pass), height finite.
    pub fn new(lat: f64, lon: f64, height: f64) -> Result<Self> {
        Self::named(lat, lon, height, "")
    }

    /// As [`Geodetic::new`]; `row` numbers the names in the error, `lat[4]`.
    pub fn of_row(row: usize, lat: f64, lon: f64, height: f64) -> Result<Self> {
        match Self::new(lat, lon, height) {
            Ok(position) => Ok(position),
            Err(_) => Self::named(lat, lon, height, &format!("[{row}]")),
        }
    }

    fn named(lat: f64, lon: f64, height: f64, suffix: &str) -> Result<Self> {
        let limits = [
            (
                "lat",
                lat,
                FRAC_PI_2,
                "must be radians within ±π/2; are these degrees, or is the longitude first?",
            ),
            ("lon", lon, TAU, "must be radians within ±2π; are these degrees?"),
            ("height", height, FARTHEST, "must be metres within ±1e15"),
        ];
        for (name, value, limit, requirement) in limits {
            if !value.is_finite() || value.abs() > limit {
                return Err(Error::invalid(&format!("{name}{suffix}"), value, requirement));
            }
        }
        Ok(Self { lat, lon, height })
    }

    /// ECEF coordinates, metres.
    pub fn to_ecef(&self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = (libm::sin(self.lat), libm::cos(self.lat));
        let (sin_lon, cos_lon) = (libm::sin(self.lon), libm::cos(self.lon));
        let normal = SEMI_MAJOR_AXIS / (1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat).sqrt();
        let across = (normal + self.height) * cos_lat;
        let z = ((1.0 - ECCENTRICITY_SQUARED) * normal + self.height) * sin_lat;
        Vector3::new(across * cos_lon, across * sin_lon, z)
    }

    /// The geodetic coordinates of an ECEF point, metres.
    pub fn from_ecef(point: &Vector3<f64>) -> Result<Self> {
        require_finite("ECEF coordinates", point.iter())?;
        if point.amax() > FARTHEST {
            return Err(Error::invalid(
                "ECEF coordinates",
                point.amax(),
                "must be metres below 1e15",
            ));
        }
        let (x, y, z) = (point.x, point.y, point.z);
        let rho = libm::hypot(x, y);
        let lon = if rho > 0.0 { libm::atan2(y, x) } else { 0.0 };
        let meridian = in_meridian(rho, z);
        Ok(Self {
            lat: meridian.lat,
            lon,
            height: meridian.height,
        })
    }
}

struct Meridian {
    lat: f64,
    height: f64,
}

/// Latitude and height of the point ρ from the axis, z above the equator.
fn in_meridian(rho: f64, z: f64) -> Meridian {
    const E2: f64 = ECCENTRICITY_SQUARED;
    const E4: f64 = E2 * E2;
    let p = (rho / SEMI_MAJOR_AXIS) * (rho / SEMI_MAJOR_AXIS);
    let q = (1.0 - E2) * (z / SEMI_MAJOR_AXIS) * (z / SEMI_MAJOR_AXIS);
    // So near to the plane of the equator that products with q would underflow.
    if q < 1e-290 && p <= E4 {
        let lat = libm::atan2((E4 - p).sqrt(), (1.0 - E2).sqrt() * p.sqrt());
        return Meridian {
            lat: libm::copysign(lat, z),
            height: -SEMI_MAJOR_AXIS * (1.0 - E2).sqrt() * ((E2 - p) / E2).sqrt(),
        };
    }
    let r = (p + q - E4) / 6.0;
    let (cube, product) = (8.0 * r * r * r, E4 * p * q);
    let u = if cube + product > 0.0 {
        let root = libm::cbrt((cube + product).sqrt() + product.sqrt());
        r + 0.5 * root * root + 2.0 * (r / root) * (r / root)
    } else {
        let t = libm::atan2(product.sqrt(), (-cube - product).sqrt() + (-cube).sqrt()) * (2.0 / 3.0);
        -4.0 * r * libm::sin(t) * libm::cos(FRAC_PI_6 + t)
    };
    let v = (u * u + E4 * q).sqrt();
    let w = E2 * (u + v - q) / (2.0 * v);
    let k = (u + v) / ((w * w + u + v).sqrt() + w);
    let d = k * rho / (k + E2);
    Meridian {
        lat: libm::atan2(z, d),
        height: (k + E2 - 1.0) / k * libm::hypot(d, z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn back(lat: f64, lon: f64, height: f64) -> Geodetic {
        Geodetic::from_ecef(&Geodetic::new(lat, lon, height).unwrap().to_ecef()).unwrap()
    }

    #[test]
    fn axes_of_the_ellipsoid() {
        let polar_axis = SEMI_MAJOR_AXIS * (1.0 - FLATTENING);
        let pole = Geodetic::new(FRAC_PI_2, 0.0, 0.0).unwrap().to_ecef();
        assert!((pole - Vector3::new(0.0, 0.0, polar_axis)).norm() < 2e-9);
        let equator = Geodetic::new(0.0, FRAC_PI_2, 10.0).unwrap().to_ecef();
        assert!((equator - Vector3::new(0.0, SEMI_MAJOR_AXIS + 10.0, 0.0)).norm() < 2e-9);
    }

    #[test]
    fn pole_and_antimeridian_come_back() {
        assert_eq!(back(FRAC_PI_2, 0.0, 100.0).lat, FRAC_PI_2);
        assert!((back(-FRAC_PI_2, 1.0, -4000.0).height + 4000.0).abs() < 1e-8);
        assert!((back(0.3, PI, 0.0).lon.abs() - PI).abs() < 1e-15);
        assert!((back(0.3, 1.5 * PI, 0.0).lon + 0.5 * PI).abs() < 1e-15);
        let on_axis = Geodetic::from_ecef(&Vector3::new(-0.0, -0.0, 7e6)).unwrap();
        assert_eq!((on_axis.lat, on_axis.lon), (FRAC_PI_2, 0.0));
    }

    #[test]
    fn every_point_inside_the_evolute_comes_back_too() {
        let radii = [0.0, 1e-200, 1e-6, 1.0, 1e3, 4.2e4, 4.3e4, 1e5, 1e6];
        for rho in radii {
            for z in radii.iter().flat_map(|&z| [z, -z]) {
                let point = Vector3::new(rho, 0.0, z);
                let image = Geodetic::from_ecef(&point).unwrap().to_ecef();
                assert!((image - point).norm() < 1e-6, "{point:?} {image:?}");
            }
        }
    }

    #[test]
    fn degrees_and_absurd_values_are_named() {
        let text = |lat, lon, height| Geodetic::new(lat, lon, height).unwrap_err().to_string();
        assert!(text(48.1, 0.2, 0.0).starts_with("lat = 48.1") && text(48.1, 0.2, 0.0).contains("radians"));
        assert!(text(0.8, 11.6, 0.0).starts_with("lon = 11.6") && text(0.8, 11.6, 0.0).contains("degrees"));
        assert!(text(f64::NAN, 0.0, 0.0).starts_with("lat"));
        assert!(text(0.0, f64::INFINITY, 0.0).starts_with("lon"));
        assert!(text(0.0, 0.0, 1e300).starts_with("height"));
        let row = Geodetic::of_row(4, 2.0, 0.0, 0.0).unwrap_err().to_string();
        assert!(row.starts_with("lat[4] = 2"));
        assert!(Geodetic::from_ecef(&Vector3::new(1.0, f64::NAN, 0.0)).is_err());
        assert!(Geodetic::from_ecef(&Vector3::new(1.0, 1e200, 0.0)).is_err());
    }
}
