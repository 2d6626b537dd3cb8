//! The sRGB transfer function (IEC 61966-2-1) by table.

use std::sync::LazyLock;

/// Linear value of an sRGB level.
fn decode(level: f64) -> f64 {
    let encoded = level / 255.0;
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

const COARSE: usize = 4096;

/// Tables for both directions.
pub(crate) struct SrgbTables {
    linear_of_level: [f32; 256],
    /// `lower_edge[k]` is the smallest linear value that rounds to level k; the last is infinite.
    lower_edge: [f32; 257],
    /// Level at the start of each of equally wide steps of the linear value.
    level_of_step: [u8; COARSE + 1],
}

static TABLES: LazyLock<SrgbTables> = LazyLock::new(|| {
    let mut lower_edge = [f32::INFINITY; 257];
    lower_edge[0] = f32::NEG_INFINITY;
    for (level, edge) in lower_edge.iter_mut().enumerate().take(256).skip(1) {
        *edge = decode(level as f64 - 0.5) as f32;
    }
    let level_of_step = std::array::from_fn(|step| {
        let linear = step as f32 / COARSE as f32;
        lower_edge[1..256].partition_point(|&edge| edge <= linear) as u8
    });
    SrgbTables {
        linear_of_level: std::array::from_fn(|level| decode(level as f64) as f32),
        lower_edge,
        level_of_step,
    }
});

impl SrgbTables {
    pub fn get() -> &'static Self {
        &TABLES
    }

    /// Linear value of an sRGB level.
    #[inline(always)]
    pub fn decode(&self, level: u8) -> f32 {
        self.linear_of_level[usize::from(level)]
    }

    /// Nearest sRGB level of a linear value, clamped to 0..1; NaN gives 0.
    #[inline(always)]
    pub fn encode(&self, linear: f32) -> u8 {
        let step = (linear.clamp(0.0, 1.0) * COARSE as f32) as usize;
        let level = self.level_of_step[step.min(COARSE)];
        // A step is narrower than any level, so that one comparison is enough.
        level + u8::from(linear >= self.lower_edge[usize::from(level) + 1])
    }

    /// [`Self::encode`] of several values.
    #[inline(always)]
    pub fn encode_lanes<const N: usize>(&self, linear: &[f32; N]) -> [u8; N] {
        let mut steps = [0i32; N];
        for (step, &value) in steps.iter_mut().zip(linear) {
            let value = if value > 0.0 { value } else { 0.0 };
            let value = if value < 1.0 { value } else { 1.0 };
            *step = (value * COARSE as f32) as i32;
        }
        std::array::from_fn(|i| {
            let level = self.level_of_step[(steps[i] as usize).min(COARSE)];
            level + u8::from(linear[i] >= self.lower_edge[usize::from(level) + 1])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_round_trip_and_round_to_nearest() {
        let tables = SrgbTables::get();
        for level in 0..=255u8 {
            assert_eq!(tables.encode(tables.decode(level)), level);
        }
        for step in 0..100_000 {
            let linear = f64::from(step) / 99_999.0;
            let encoded = if linear <= 0.003_130_8 {
                linear * 12.92
            } else {
                1.055 * linear.powf(1.0 / 2.4) - 0.055
            };
            let found = tables.encode(linear as f32);
            assert_eq!(tables.encode_lanes(&[linear as f32; 8]), [found; 8]);
            let found = f64::from(found);
            assert!((found - encoded * 255.0).abs() < 0.501, "{linear}: {found} {encoded}");
        }
        assert_eq!(tables.encode(f32::NAN), 0);
        assert_eq!((tables.encode(-1.0), tables.encode(7.0)), (0, 255));
        assert_eq!(tables.encode_lanes(&[f32::NAN, -1.0, 7.0]), [0, 0, 255]);
    }
}
