//! Seeded random streams: run k of a study draws from stream (seed, k), whatever the number of cores and the machine.
//!
//! | symbol | name here       | meaning                                                        |
//! |--------|-----------------|----------------------------------------------------------------|
//! | s, k   | `seed`, `run`   | what names a stream                                            |
//! | e      | `entropy`       | words of s, padded to four, then those of k, least significant first |
//! | p      | `pool`          | four mixed words                                               |
//! | u      | [`Stream::uniform`] | 53 bits in [0, 1)                                          |
//!
//! Equations, in the order of the code:
//!
//! 1. p = mix(e): every word of e is hashed into every word of the pool; eight words drawn from p are the 256 bits that
//!    set state and increment of the generator, PCG XSL RR 128/64. Seed sequence and generator are the published ones, so that
//!    other implementations give the same bits for seed s and spawn key (k).
//! 2. u = ⌊b / 2¹¹⌋ 2⁻⁵³ of the next 64 bits b.
//! 3. Normal deviates in pairs (Box, Muller): r = √(−2 ln(1 − u₁)), then r cos 2πu₂ and r sin 2πu₂; |r| ≤ 8.6.
//! 4. Poisson: the arrivals of a process of unit rate before the mean, that is the number of waiting times −ln(1 − u)
//!    whose sum stays below it. Exact for every mean; the cost grows with it.
//! 5. Choice among n: ⌊b n / 2⁶⁴⌋, drawn again where b n mod 2⁶⁴ < 2⁶⁴ mod n, so that no element is favoured (Lemire).
//!
//! Logarithm, sine and cosine are those of the `libm` crate: the same bits everywhere.
//!
//! References: M. O'Neill, *PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number
//! Generation*, 2014, and *Simple Portable C++ Seed Entropy*, 2015; G. Box, M. Muller, *A Note on the Generation of
//! Random Normal Deviates*, 1958; D. Lemire, *Fast Random Integer Generation in an Interval*, 2019.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng;
use std::f64::consts::TAU;

use crate::error::{Result, require_non_negative};

const POOL: usize = 4;

/// A stream of random numbers. Cloned, it goes on twice from where it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Stream {
    generator: Pcg64,
    /// The second of a pair of normal deviates.
    spare: Option<f64>,
}

impl Stream {
    /// The stream of run `run` of a study with this seed.
    pub fn new(seed: u64, run: u64) -> Self {
        let mut entropy = words(seed);
        entropy.resize(POOL, 0);
        entropy.extend(words(run));
        let [state, increment] = SeedPool::new(&entropy).state();
        Self {
            generator: Pcg64::new(state, increment),
            spare: None,
        }
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.generator.next_u64()
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * f64::EPSILON / 2.0
    }

    /// Uniform from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normal with mean 0 and variance 1.
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = libm::sqrt(2.0 * self.waiting_time());
        let angle = TAU * self.uniform();
        self.spare = Some(radius * libm::sin(angle));
        radius * libm::cos(angle)
    }

    /// Poisson with this mean, which must not be negative.
    pub fn poisson(&mut self, mean: f64) -> Result<usize> {
        require_non_negative("mean of a Poisson number", mean)?;
        let mut arrivals = 0;
        let mut time = self.waiting_time();
        while time < mean {
            arrivals += 1;
            time += self.waiting_time();
        }
        Ok(arrivals)
    }

    /// One of these, each as likely as any other; none of none.
    pub fn choice<'a, T>(&mut self, items: &'a [T]) -> Option<&'a T> {
        let count = items.len() as u64;
        if count == 0 {
            return None;
        }
        let unfair = count.wrapping_neg() % count;
        loop {
            let bits = self.bits();
            if bits.wrapping_mul(count) >= unfair {
                let index = usize::try_from((u128::from(bits) * u128::from(count)) >> 64);
                return index.ok().and_then(|index| items.get(index));
            }
        }
    }

    /// Exponential with mean 1.
    fn waiting_time(&mut self) -> f64 {
        -libm::log(1.0 - self.uniform())
    }
}

/// The 32-bit words of a number, least significant first, without leading zeros.
fn words(value: u64) -> Vec<u32> {
    let (low, high) = ((value & 0xffff_ffff) as u32, (value >> 32) as u32);
    if high == 0 { vec![low] } else { vec![low, high] }
}

/// The mixed entropy of a seed.
struct SeedPool([u32; POOL]);

impl SeedPool {
    fn new(entropy: &[u32]) -> Self {
        let mut hash = Hash {
            constant: 0x43b0_d7e5,
            factor: 0x931e_8875,
        };
        let mut pool = [0; POOL];
        for (i, word) in pool.iter_mut().enumerate() {
            *word = hash.of(entropy.get(i).copied().unwrap_or(0));
        }
        for from in 0..POOL {
            for to in 0..POOL {
                if from != to {
                    pool[to] = mixed(pool[to], hash.of(pool[from]));
                }
            }
        }
        for &more in entropy.iter().skip(POOL) {
            for word in &mut pool {
                *word = mixed(*word, hash.of(more));
            }
        }
        Self(pool)
    }

    /// State and increment of the generator.
    fn state(&self) -> [u128; 2] {
        let mut hash = Hash {
            constant: 0x8b51_f9dd,
            factor: 0x58f3_8ded,
        };
        let mut source = self.0.iter().cycle();
        let mut word = || u128::from(source.next().map_or(0, |&value| hash.of(value)));
        // Words of 64 bits have their lower half first, those of 128 bits their upper.
        std::array::from_fn(|_| {
            let parts: [u128; 4] = std::array::from_fn(|_| word());
            parts[1] << 96 | parts[0] << 64 | parts[3] << 32 | parts[2]
        })
    }
}

/// A hash whose constant moves on with every word.
struct Hash {
    constant: u32,
    factor: u32,
}

impl Hash {
    fn of(&mut self, word: u32) -> u32 {
        let value = word ^ self.constant;
        self.constant = self.constant.wrapping_mul(self.factor);
        let value = value.wrapping_mul(self.constant);
        value ^ (value >> 16)
    }
}

fn mixed(a: u32, b: u32) -> u32 {
    let value = a.wrapping_mul(0xca01_f9dd).wrapping_sub(b.wrapping_mul(0x4973_f715));
    value ^ (value >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// First outputs with state 42 and stream 54 in the test suite of the PCG library in C (pcg-c, `check-pcg64`).
    #[test]
    fn generator_is_the_published_one() {
        let mut generator = Pcg64::new(42, 54);
        let expected = [0x86b1_da1d_7206_2b68, 0x1304_aa46_c985_3d39, 0xa367_0e9e_0dd5_0358];
        assert_eq!([(); 3].map(|()| generator.next_u64()), expected);
    }

    #[test]
    fn choice_takes_all_and_only_what_there_is() {
        let mut stream = Stream::new(1, 0);
        let mut counts = [0; 5];
        for _ in 0..5000 {
            counts[*stream.choice(&[0, 1, 2, 3, 4]).unwrap()] += 1;
        }
        // Binomial with standard deviation 28.
        assert!(counts.iter().all(|&c| (900..1100).contains(&c)), "{counts:?}");
        assert_eq!(stream.choice::<u8>(&[]), None);
    }

    #[test]
    fn poisson_refuses_a_mean_that_is_none() {
        let mut stream = Stream::new(1, 0);
        assert_eq!(stream.poisson(0.0), Ok(0));
        for mean in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(stream.poisson(mean).is_err());
        }
    }
}
