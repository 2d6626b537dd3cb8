//! Random numbers that depend on what they are for, never on a thread or an order of calls.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The hash of everything that a stream of random numbers is for (FNV-1a, 64 bits).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(u64);

impl Seed {
    /// Of the user's seed.
    pub fn new(seed: u64) -> Self {
        Self(0xcbf2_9ce4_8422_2325).number(seed)
    }

    /// Narrowed down by a name: an episode's identity, a camera, a purpose.
    #[must_use]
    pub fn name(self, name: &str) -> Self {
        // The length ends the name, so that "a", "bc" differs from "ab", "c".
        self.bytes(name.as_bytes()).number(name.len() as u64)
    }

    /// Narrowed down by a number.
    #[must_use]
    pub fn number(self, number: u64) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    fn bytes(self, bytes: &[u8]) -> Self {
        let step = |hash: u64, &byte: &u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
        Self(bytes.iter().fold(self.0, step))
    }

    /// The stream.
    pub fn stream(self) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(self.0)
    }
}

/// Standard normal numbers by Box and Muller's transform, in pairs.
#[derive(Debug, Default)]
pub struct Normal {
    second: Option<f64>,
}

impl Normal {
    /// The next one.
    pub fn next(&mut self, random: &mut impl Rng) -> f64 {
        if let Some(second) = self.second.take() {
            return second;
        }
        let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * random.random::<f64>()).sin_cos();
        self.second = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_purpose_alone() {
        let draw = |seed: Seed| seed.stream().random::<u64>();
        assert_eq!(draw(Seed::new(1).name("a").number(2)), draw(Seed::new(1).name("a").number(2)));
        let others = [
            Seed::new(2).name("a").number(2),
            Seed::new(1).name("b").number(2),
            Seed::new(1).name("a").number(3),
            Seed::new(1).name("a"),
        ];
        for other in others {
            assert_ne!(draw(Seed::new(1).name("a").number(2)), draw(other));
        }
        assert_ne!(Seed::new(1).name("a").name("bc"), Seed::new(1).name("ab").name("c"));
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let (mut random, mut normal) = (Seed::new(3).stream(), Normal::default());
        let values: Vec<f64> = (0..100_000).map(|_| normal.next(&mut random)).collect();
        let mean = values.iter().sum::<f64>() / 1e5;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 1e5;
        let beyond_two = values.iter().filter(|v| v.abs() > 2.0).count() as f64 / 1e5;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        assert!((beyond_two - 0.0455).abs() < 0.004, "{beyond_two}");
    }
}
