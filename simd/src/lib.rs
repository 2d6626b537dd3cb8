//! Eight `f32` at a time: AVX2 where the processor has it, plain arrays elsewhere.
//!
//! Both do the same IEEE operations in the same order (no fused multiply-add), so that every kernel gives
//! the same bits with either. A loop is written once, as a [`Kernel`] over [`Lanes`], and compiled twice;
//! [`run`] chooses. Loops over arrays that the compiler is left to vectorise are slower: its minimum and maximum
//! take not-a-number into account, with three instructions for one.

use std::ops::{Add, Div, Mul, Sub};

/// Number of lanes.
pub const LANES: usize = 8;

/// Eight numbers in memory, aligned for one load.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C, align(32))]
pub struct Row(
    /// Lane by lane.
    pub [f32; LANES],
);

/// `[f(0), f(1), f(2)]` written out: the compiler does not always inline closures into functions that are
/// compiled for other processors than the closure.
#[macro_export]
macro_rules! xyz {
    ($i:ident => $value:expr) => {
        [
            {
                let $i = 0usize;
                $value
            },
            {
                let $i = 1usize;
                $value
            },
            {
                let $i = 2usize;
                $value
            },
        ]
    };
}

/// Which implementation runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Simd {
    /// Arrays; what the compiler's baseline makes of them.
    Portable,
    /// 256-bit registers.
    Avx2,
}

impl Simd {
    /// The best that this processor can do.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self::Avx2;
        }
        Self::Portable
    }
}

/// A loop over [`Lanes`], for [`run`].
pub trait Kernel {
    /// What it computes.
    type Output;

    /// Computes it; must be `#[inline(always)]`, as must all that it calls, or nothing is compiled for the lanes' processor.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs a kernel in the lanes asked for, or in portable ones where the processor lacks those.
#[inline]
pub fn run<K: Kernel>(simd: Simd, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if simd == Simd::Avx2 && std::arch::is_x86_feature_detected!("avx2") {
        #[target_feature(enable = "avx2")]
        fn wide<K: Kernel>(kernel: K) -> K::Output {
            kernel.run::<Avx2>()
        }
        // SAFETY: the processor has AVX2.
        return unsafe { wide(kernel) };
    }
    let _ = simd;
    kernel.run::<Array>()
}

/// Eight numbers in registers. What minimum, maximum and comparisons make of not-a-number is unspecified.
pub trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// The same number in all lanes.
    fn splat(value: f32) -> Self;
    /// From memory.
    fn load(row: &Row) -> Self;
    /// To memory.
    fn store(self, row: &mut Row);
    /// The smaller ones.
    fn min(self, other: Self) -> Self;
    /// The larger ones.
    fn max(self, other: Self) -> Self;
    /// Absolute values.
    fn abs(self) -> Self;
    /// Largest integers that are not larger.
    fn floor(self) -> Self;
    /// Square roots.
    fn sqrt(self) -> Self;
    /// Bit i is set where lane i is less than that of `other`.
    fn less(self, other: Self) -> u32;
    /// The smallest of the eight.
    fn smallest(self) -> f32;
    /// The largest of the eight.
    fn largest(self) -> f32;
}

/// The portable implementation.
#[derive(Clone, Copy)]
struct Array([f32; LANES]);

impl Array {
    #[inline(always)]
    fn map(self, f: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(f))
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }
}

impl Add for Array {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Array {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Array {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Div for Array {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl Lanes for Array {
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn load(row: &Row) -> Self {
        Self(row.0)
    }

    #[inline(always)]
    fn store(self, row: &mut Row) {
        row.0 = self.0;
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.map(f32::abs)
    }

    #[inline(always)]
    fn floor(self) -> Self {
        self.map(f32::floor)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }

    #[inline(always)]
    fn less(self, other: Self) -> u32 {
        (0..LANES).fold(0, |mask, i| mask | u32::from(self.0[i] < other.0[i]) << i)
    }

    #[inline(always)]
    fn smallest(self) -> f32 {
        self.0.iter().copied().fold(f32::INFINITY, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn largest(self) -> f32 {
        self.0.iter().copied().fold(f32::NEG_INFINITY, |a, b| if a > b { a } else { b })
    }
}

#[cfg(target_arch = "x86_64")]
use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;
    use std::ops::{Add, Div, Mul, Sub};

    use super::{Lanes, Row};

    /// One 256-bit register. Values exist only inside kernels that [`super::run`] has found AVX2 for; every block below
    /// relies on that.
    #[derive(Clone, Copy)]
    pub(super) struct Avx2(__m256);

    impl Add for Avx2 {
        type Output = Self;
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_add_ps(self.0, other.0) })
        }
    }

    impl Sub for Avx2 {
        type Output = Self;
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_sub_ps(self.0, other.0) })
        }
    }

    impl Mul for Avx2 {
        type Output = Self;
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_mul_ps(self.0, other.0) })
        }
    }

    impl Div for Avx2 {
        type Output = Self;
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_div_ps(self.0, other.0) })
        }
    }

    impl Lanes for Avx2 {
        #[inline(always)]
        fn splat(value: f32) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_set1_ps(value) })
        }

        #[inline(always)]
        fn load(row: &Row) -> Self {
            // SAFETY: the processor has AVX2, see the type; a `Row` is 32 bytes, aligned to 32.
            Self(unsafe { _mm256_load_ps(row.0.as_ptr()) })
        }

        #[inline(always)]
        fn store(self, row: &mut Row) {
            // SAFETY: the processor has AVX2, see the type; a `Row` is 32 bytes, aligned to 32.
            unsafe { _mm256_store_ps(row.0.as_mut_ptr(), self.0) }
        }

        #[inline(always)]
        fn min(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn max(self, other: Self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn abs(self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
        }

        #[inline(always)]
        fn floor(self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_floor_ps(self.0) })
        }

        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: the processor has AVX2, see the type.
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }

        #[inline(always)]
        fn less(self, other: Self) -> u32 {
            // SAFETY: the processor has AVX2, see the type.
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
        }

        #[inline(always)]
        fn smallest(self) -> f32 {
            // SAFETY: the processor has AVX2, see the type.
            unsafe {
                let upper = _mm256_extractf128_ps::<1>(self.0);
                let four = _mm_min_ps(_mm256_castps256_ps128(self.0), upper);
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
            }
        }

        #[inline(always)]
        fn largest(self) -> f32 {
            // SAFETY: the processor has AVX2, see the type.
            unsafe {
                let upper = _mm256_extractf128_ps::<1>(self.0);
                let four = _mm_max_ps(_mm256_castps256_ps128(self.0), upper);
                let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_max_ss(two, _mm_movehdup_ps(two)))
            }
        }
    }
}

/// Sine and cosine, within 1e-6 for angles of a few turns.
///
/// The angle is brought to -pi..pi, a quarter of it goes through Taylor's series to the ninth and eighth
/// power (below 4e-9 of truncation at pi / 4), and two doublings bring it back: no lane takes a branch.
#[inline(always)]
pub fn sin_cos<L: Lanes>(angle: L) -> (L, L) {
    // 2 pi in two parts (Cody and Waite, *Software Manual for the Elementary Functions*, 1980).
    const TURN_HIGH: f32 = 6.281_25;
    const TURN_LOW: f32 = 0.001_935_307_2;
    let k = L::splat;
    let turns = (angle * k(0.159_154_94) + k(0.5)).floor();
    let h = (angle - turns * k(TURN_HIGH) - turns * k(TURN_LOW)) * k(0.25);
    let h2 = h * h;
    let sin_terms = k(2.755_731_9e-6) * h2 - k(1.984_127e-4);
    let sin = h + h * h2 * ((sin_terms * h2 + k(8.333_333e-3)) * h2 - k(0.166_666_67));
    let cos_terms = k(2.480_158_7e-5) * h2 - k(1.388_888_9e-3);
    let cos = k(1.0) + h2 * ((cos_terms * h2 + k(0.041_666_668)) * h2 - k(0.5));
    let (sin, cos) = double_angle(sin, cos);
    double_angle(sin, cos)
}

#[inline(always)]
fn double_angle<L: Lanes>(sin: L, cos: L) -> (L, L) {
    let twice = sin + sin;
    (twice * cos, L::splat(1.0) - twice * sin)
}

/// Smallest of eight numbers and its lane; the first of equals.
#[inline(always)]
pub fn least(row: &Row) -> (f32, usize) {
    let mut best = (row.0[0], 0);
    for (lane, &value) in row.0.iter().enumerate().skip(1) {
        if value < best.0 {
            best = (value, lane);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<Row> {
        (0..400).map(|i| Row(std::array::from_fn(|l| (i * 8 + l) as f32 * 0.0125 - 20.0))).collect()
    }

    /// All operations on two rows.
    struct Everything<'a>(&'a Row, &'a Row);

    impl Kernel for Everything<'_> {
        type Output = ([Row; 11], u32, [f32; 2]);

        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let (x, y) = (L::load(self.0), L::load(self.1));
            let (sin, cos) = sin_cos(x);
            let all = [x + y, x - y, x * y, x.min(y), x.max(y), x.abs(), x.floor(), sin, cos];
            let mut out = [Row::default(); 11];
            all.iter().zip(&mut out).for_each(|(value, row)| value.store(row));
            x.abs().sqrt().store(&mut out[9]);
            (x / y).store(&mut out[10]);
            (out, x.less(y), [sin.smallest(), sin.largest()])
        }
    }

    #[test]
    fn sine_and_cosine_are_within_a_millionth() {
        for row in rows() {
            let (sin, cos) = sin_cos(Array::load(&row));
            for (i, angle) in row.0.iter().enumerate() {
                let (s, c) = f64::from(*angle).sin_cos();
                let error = (f64::from(sin.0[i]) - s).abs().max((f64::from(cos.0[i]) - c).abs());
                assert!(error < 1.5e-6, "{angle}: {error}");
            }
        }
    }

    #[test]
    fn portable_gives_the_bits_of_scalar_arithmetic() {
        let rows = rows();
        let (out, mask, ends) = run(Simd::Portable, Everything(&rows[3], &rows[250]));
        for i in 0..LANES {
            let (a, b) = (rows[3].0[i], rows[250].0[i]);
            let expected = [a + b, a - b, a * b, a.min(b), a.max(b), a.abs(), a.floor()];
            assert_eq!(expected, std::array::from_fn(|k| out[k].0[i]));
            assert_eq!(mask >> i & 1 == 1, a < b);
        }
        let sines = out[7].0;
        let expected = [sines.into_iter().reduce(f32::min), sines.into_iter().reduce(f32::max)];
        assert_eq!(ends.map(Some), expected);
    }

    #[test]
    fn the_best_lanes_give_the_bits_of_portable_ones() {
        let rows = rows();
        let bits = |simd, a, b| {
            let (rows, mask, ends) = run(simd, Everything(a, b));
            (rows.map(|r| r.0.map(f32::to_bits)), mask, ends.map(f32::to_bits))
        };
        for (a, b) in rows.iter().zip(rows.iter().rev()) {
            assert_eq!(bits(Simd::detect(), a, b), bits(Simd::Portable, a, b));
        }
    }
}
