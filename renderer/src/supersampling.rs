//! Smooth colours: several samples a pixel, by any backend.

use std::fmt;
use std::str::FromStr;

use akrobat_cameras::CameraFrame;
use serde::{Deserialize, Serialize};

use crate::srgb::SrgbTables;
use crate::{Backend, FrameState, PlacedCamera, RenderError, RenderScene};

/// Samples along either edge of a pixel. The number is odd, so that the middle one lies at the pixel's centre: depth,
/// segmentation and normals are its own, and colour is the mean of all in linear light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u32", into = "u32")]
pub struct Supersampling(u32);

impl Default for Supersampling {
    fn default() -> Self {
        Self(1)
    }
}

impl TryFrom<u32> for Supersampling {
    type Error = String;

    fn try_from(samples: u32) -> Result<Self, Self::Error> {
        match samples {
            1 | 3 | 5 => Ok(Self(samples)),
            other => Err(format!("valid choices: 1, 3, 5; got {other}")),
        }
    }
}

impl From<Supersampling> for u32 {
    fn from(Supersampling(samples): Supersampling) -> Self {
        samples
    }
}

impl FromStr for Supersampling {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let samples = text.parse::<u32>();
        samples
            .map_err(|_| format!("valid choices: 1, 3, 5; got \"{text}\""))
            .and_then(Self::try_from)
    }
}

impl fmt::Display for Supersampling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Supersampling {
    /// A backend that draws with these samples.
    pub fn over(self, backend: Box<dyn Backend>) -> Box<dyn Backend> {
        match self.0 {
            1 => backend,
            samples => Box::new(Supersampled { samples, backend }),
        }
    }
}

struct Supersampled {
    samples: u32,
    backend: Box<dyn Backend>,
}

impl Backend for Supersampled {
    fn name(&self) -> &str {
        self.backend.name()
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        let fine: Vec<_> = cameras.iter().map(|camera| enlarged(camera, self.samples)).collect();
        let images = self.backend.render(scene, frame, &fine)?;
        Ok(images.iter().zip(cameras).map(|(i, c)| reduced(i, c, self.samples as usize)).collect())
    }

    fn render_batch(
        &mut self,
        scene: &RenderScene,
        frames: &[(FrameState, Vec<PlacedCamera>)],
    ) -> Result<Vec<Vec<CameraFrame>>, RenderError> {
        let fine: Vec<_> = frames
            .iter()
            .map(|(frame, cameras)| {
                (frame.clone(), cameras.iter().map(|c| enlarged(c, self.samples)).collect())
            })
            .collect();
        let batch = self.backend.render_batch(scene, &fine)?;
        let reduce = |(images, (_, cameras)): (Vec<CameraFrame>, &(_, Vec<PlacedCamera>))| {
            let pairs = images.iter().zip(cameras);
            pairs.map(|(i, c)| reduced(i, c, self.samples as usize)).collect()
        };
        Ok(batch.into_iter().zip(frames).map(reduce).collect())
    }
}

fn enlarged(camera: &PlacedCamera, samples: u32) -> PlacedCamera {
    let mut fine = camera.clone();
    let k = &mut fine.intrinsics;
    (k.width, k.height) = (k.width * samples, k.height * samples);
    for value in [&mut k.fx, &mut k.fy, &mut k.cx, &mut k.cy] {
        *value *= f64::from(samples);
    }
    fine
}

fn reduced(fine: &CameraFrame, camera: &PlacedCamera, samples: usize) -> CameraFrame {
    let srgb = SrgbTables::get();
    let (width, height) = (camera.intrinsics.width as usize, camera.intrinsics.height as usize);
    let fine_width = width * samples;
    let mut frame = CameraFrame::new(&camera.name, camera.intrinsics, camera.world_from_camera);
    let share = 1.0 / (samples * samples) as f32;
    for v in 0..height {
        for u in 0..width {
            let mut sum = [0.0; 3];
            for row in v * samples..(v + 1) * samples {
                let first = 3 * (row * fine_width + u * samples);
                for pixel in fine.rgb[first..first + 3 * samples].as_chunks::<3>().0 {
                    (0..3).for_each(|channel| sum[channel] += srgb.decode(pixel[channel]));
                }
            }
            frame.rgb.extend(sum.map(|total: f32| srgb.encode(total * share)));
            let center = (v * samples + samples / 2) * fine_width + u * samples + samples / 2;
            frame.depth_m.push(fine.depth_m[center]);
            frame.segmentation.push(fine.segmentation[center]);
            frame.normals.extend(fine.normals.get(center));
        }
    }
    frame
}
