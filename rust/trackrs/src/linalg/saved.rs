//! How matrices and vectors are saved: a shape and the numbers row by row, checked when read back.
//!
//! For use as `#[serde(with = "...")]` on fields.

/// Matrices.
pub mod matrix {
    use nalgebra::DMatrix;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    #[derive(Serialize, Deserialize)]
    struct Saved {
        rows: usize,
        columns: usize,
        values: Vec<f64>,
    }

    /// Writes the matrix.
    pub fn serialize<S: Serializer>(matrix: &DMatrix<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        let saved = Saved {
            rows: matrix.nrows(),
            columns: matrix.ncols(),
            values: matrix.transpose().as_slice().to_vec(),
        };
        saved.serialize(serializer)
    }

    /// Reads the matrix; its shape must fit its numbers, and they must be finite.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DMatrix<f64>, D::Error> {
        let saved = Saved::deserialize(deserializer)?;
        if saved.rows.checked_mul(saved.columns) != Some(saved.values.len()) {
            return Err(D::Error::custom("the shape of a saved matrix does not fit its numbers"));
        }
        if saved.values.iter().any(|v| !v.is_finite()) {
            return Err(D::Error::custom("a saved matrix is not finite"));
        }
        Ok(DMatrix::from_row_slice(saved.rows, saved.columns, &saved.values))
    }
}

/// Vectors.
pub mod vector {
    use nalgebra::DVector;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    /// Writes the vector.
    pub fn serialize<S: Serializer>(vector: &DVector<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        vector.as_slice().serialize(serializer)
    }

    /// Reads the vector; its numbers must be finite.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DVector<f64>, D::Error> {
        let values = Vec::<f64>::deserialize(deserializer)?;
        if values.iter().any(|v| !v.is_finite()) {
            return Err(D::Error::custom("a saved vector is not finite"));
        }
        Ok(DVector::from_vec(values))
    }
}
