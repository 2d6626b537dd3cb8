//! ACT: one `episode_<i>.hdf5` per episode.
//!
//! `action [T, A]`, `observations/{qpos, qvel} [T, D]`, `observations/images/<camera> [T, H, W, 3]` u8,
//! attributes `sim` and `compress`. With JPEG, an image is a row of bytes padded with zeros to the longest of
//! its camera, and `compress_len [cameras, T]` holds the lengths, as the ALOHA scripts do it.
//!
//! ALOHA encodes RGB arrays with OpenCV, which takes them for BGR, and decodes them likewise: the arrays
//! come back as they were, but the streams hold blue in the place of red. Ours do the same, so that ACT's
//! own loader gives RGB with both encodings.

use std::path::{Path, PathBuf};

use super::config::ExportConfig;
use super::sink::{ExportHeader, Sink};
use super::source::{Episode, FrameBatch};
use super::stack::{self, FrameStack};
use super::{write_attributes, write_camera_series, write_conventions};
use crate::error::{PackError, Result};
use crate::h5::H5Writer;

/// Quality of the JPEG streams.
const JPEG_QUALITY: u8 = 95;

/// Writes a folder of ACT episodes.
pub(super) struct ActSink {
    folder: PathBuf,
    header: ExportHeader,
    open: Option<OpenFile>,
}

struct OpenFile {
    file: H5Writer,
    path: PathBuf,
    images: Images,
}

enum Images {
    Plain(Vec<FrameStack>),
    /// JPEG streams by camera and frame.
    Jpeg(Vec<Vec<Vec<u8>>>),
}

impl ActSink {
    pub fn new(folder: &Path, header: &ExportHeader) -> Self {
        Self { folder: folder.to_path_buf(), header: header.clone(), open: None }
    }

    fn config(&self) -> &ExportConfig {
        &self.header.config
    }

    fn open(&mut self) -> &mut OpenFile {
        self.open.as_mut().expect("frames come between begin and end")
    }
}

impl Sink for ActSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let path = self.folder.join(format!("episode_{}.hdf5", episode.index));
        let file = H5Writer::create(&path)?;
        let root = file.root();
        write_conventions(&root, &self.header)?;
        write_attributes(&root, episode)?;
        root.attr("sim", true)?;
        root.attr("compress", self.config().jpeg)?;
        let frames = episode.frames();
        root.array("action", &[frames, episode.action.columns()], &episode.action.values)?;
        let observations = root.group("observations")?;
        let state = &episode.state;
        observations.array("qpos", &[frames, state.columns()], &state.values)?;
        let columns = episode.robot.joints.len();
        observations.array("qvel", &[frames, columns], &episode.robot.velocity)?;
        write_camera_series(&observations.group("cameras")?, episode)?;
        let group = observations.group("images")?;
        let images = if self.config().jpeg {
            root.attr_str(
                "color_order_jpeg",
                "OpenCV's imdecode gives RGB; other decoders see red and blue exchanged",
            )?;
            Images::Jpeg(vec![Vec::new(); episode.cameras.len()])
        } else {
            let stacks = episode.cameras.iter().map(|camera| {
                let shape = [frames, camera.height, camera.width, 3];
                FrameStack::create::<u8>(&group, &camera.name, &shape)
            });
            Images::Plain(stacks.collect::<Result<_>>()?)
        };
        self.open = Some(OpenFile { file, path, images });
        Ok(())
    }

    fn frames(&mut self, episode: &Episode, batch: &FrameBatch) -> Result<()> {
        let open = self.open();
        match &mut open.images {
            Images::Plain(stacks) => {
                let frames: Vec<stack::Frames<'_>> = stacks
                    .iter()
                    .zip(&batch.cameras)
                    .map(|(stack, camera)| stack::Frames {
                        stack,
                        first: batch.first,
                        bytes: camera.rgb.clone(),
                    })
                    .collect();
                stack::write(&open.path, batch.count, &frames)
            }
            Images::Jpeg(streams) => {
                let cameras = episode.cameras.iter().zip(&batch.cameras);
                for (streams, (camera, images)) in streams.iter_mut().zip(cameras) {
                    for rgb in images.rgb.chunks(camera.width * camera.height * 3) {
                        let size = [camera.width as u32, camera.height as u32];
                        streams.push(jpeg_of_exchanged(rgb, size, &open.path)?);
                    }
                }
                Ok(())
            }
        }
    }

    fn end(&mut self, episode: &Episode) -> Result<()> {
        let open = self.open.take().expect("an episode that ends was begun");
        if let Images::Jpeg(streams) = &open.images {
            let root = open.file.root();
            let group = root.existing("observations")?.existing("images")?;
            let frames = episode.frames();
            let mut lengths = Vec::new();
            for (camera, streams) in episode.cameras.iter().zip(streams) {
                let longest = streams.iter().map(Vec::len).max().unwrap_or(0);
                let mut padded = Vec::with_capacity(frames * longest);
                for stream in streams {
                    padded.extend(stream);
                    padded.resize(padded.len() + longest - stream.len(), 0u8);
                    lengths.push(stream.len() as u32);
                }
                group.array(&camera.name, &[frames, longest], &padded)?;
            }
            root.array("compress_len", &[episode.cameras.len(), frames], &lengths)?;
        }
        // The datasets are closed before their file.
        let OpenFile { file, images, .. } = open;
        drop(images);
        file.finish()
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

/// A JPEG stream of the image with red and blue exchanged.
fn jpeg_of_exchanged(rgb: &[u8], [width, height]: [u32; 2], path: &Path) -> Result<Vec<u8>> {
    let bgr: Vec<u8> = rgb.chunks_exact(3).flat_map(|p| [p[2], p[1], p[0]]).collect();
    let mut stream = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut stream, JPEG_QUALITY)
        .encode(&bgr, width, height, image::ExtendedColorType::Rgb8)
        .map_err(|e| PackError::Library {
            path: path.to_path_buf(),
            item: "JPEG".into(),
            message: e.to_string(),
        })?;
    Ok(stream)
}
