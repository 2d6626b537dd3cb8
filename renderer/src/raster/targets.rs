//! What cameras are drawn into, and the way back to the CPU.

use akrobat_cameras::CameraFrame;
use akrobat_gpu::{Context, GpuError, Readback, wgpu};

use super::pipeline::{COLOR_FORMAT, DEPTH_FORMAT, DISTANCE_FORMAT, NORMAL_FORMAT, SEGMENT_FORMAT};
use crate::PlacedCamera;

/// Bytes per pixel of each attachment that is read back.
const PIXEL_BYTES: u32 = 4;

/// Attachments of every camera and the memory they are read back through.
#[derive(Debug, Default)]
pub struct Targets {
    cameras: Vec<Attachments>,
    readback: Option<Readback>,
}

impl Targets {
    /// Makes the attachments match the cameras' image sizes.
    pub fn fit(&mut self, context: &Context, cameras: &[PlacedCamera]) -> Result<(), GpuError> {
        let sizes = || cameras.iter().map(|c| (c.intrinsics.width, c.intrinsics.height));
        if self.readback.is_some() && self.cameras.iter().map(|a| a.size).eq(sizes()) {
            return Ok(());
        }
        self.cameras = sizes()
            .map(|(width, height)| Attachments::new(context, width, height))
            .collect::<Result<_, _>>()?;
        let size = self.cameras.iter().map(|a| a.read_bytes()).sum();
        self.readback = Some(Readback::new(context, size)?);
        Ok(())
    }

    /// Starts drawing camera `index` on the background.
    pub fn begin<'encoder>(
        &self,
        encoder: &'encoder mut wgpu::CommandEncoder,
        index: usize,
        background_rgb: [u8; 3],
    ) -> wgpu::RenderPass<'encoder> {
        let attachments = &self.cameras[index];
        let [r, g, b] = background_rgb.map(|level| f64::from(level) / 255.0);
        let color = |view, clear| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear),
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let nothing = wgpu::Color::TRANSPARENT;
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("camera"),
            color_attachments: &[
                color(&attachments.color.view, wgpu::Color { r, g, b, a: 1.0 }),
                color(&attachments.distance.view, nothing),
                color(&attachments.segment.view, nothing),
                color(&attachments.normal.view, nothing),
            ],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &attachments.depth.view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        })
    }

    /// Copies every camera's images to the read-back memory, one after the other.
    pub fn copy_out(&self, encoder: &mut wgpu::CommandEncoder) {
        let Some(readback) = &self.readback else { return };
        let mut offset = 0;
        for attachments in &self.cameras {
            for image in attachments.images() {
                image.copy_out(encoder, readback.buffer(), offset);
                offset += image.read_bytes();
            }
        }
    }

    /// Waits for the copies and unpacks them.
    pub fn read(
        &self,
        context: &Context,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, GpuError> {
        let Some(readback) = &self.readback else { return Ok(Vec::new()) };
        readback.read(context, |mut bytes| {
            let mut unpack = |(attachments, camera): (&Attachments, &PlacedCamera)| {
                let [color, distance, segment, normal] = attachments.images().map(|image| {
                    let (mine, rest) = bytes.split_at(image.read_bytes() as usize);
                    bytes = rest;
                    image.pixels(mine)
                });
                let normals = if camera.normals {
                    let rotation = camera.world_from_camera.rotation.cast::<f32>();
                    let decode = |bytes| {
                        let in_camera = unit_from_octahedral(u32::from_le_bytes(bytes));
                        (rotation * nalgebra::Vector3::from(in_camera)).into()
                    };
                    normal.map(decode).collect()
                } else {
                    Vec::new()
                };
                let mut frame = CameraFrame {
                    rgb: color.flat_map(|[r, g, b, _]| [r, g, b]).collect(),
                    depth_m: distance.map(f32::from_le_bytes).collect(),
                    // Segment ids are u16; the attachment is wider because every device has that format.
                    segmentation: segment
                        .map(|[low, high, ..]| u16::from_le_bytes([low, high]))
                        .collect(),
                    normals,
                    ..CameraFrame::new(&camera.name, camera.intrinsics, camera.world_from_camera)
                };
                for (normal, id) in frame.normals.iter_mut().zip(&frame.segmentation) {
                    if *id == 0 {
                        *normal = [0.0; 3];
                    }
                }
                frame
            };
            self.cameras.iter().zip(cameras).map(&mut unpack).collect()
        })
    }
}

/// The unit vector of an octahedral code of twice 16 bits (Cigolle et al., *A Survey of Efficient Representations for
/// Independent Unit Vectors*, JCGT 2014).
fn unit_from_octahedral(code: u32) -> [f32; 3] {
    let [x, y] = [code & 0xffff, code >> 16].map(|half| half as f32 / 65535.0 * 2.0 - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let v = nalgebra::Vector3::new(x - fold.copysign(x), y - fold.copysign(y), z);
    v.normalize().into()
}

/// One camera's attachments.
#[derive(Debug)]
struct Attachments {
    size: (u32, u32),
    color: Image,
    distance: Image,
    segment: Image,
    normal: Image,
    depth: Image,
}

impl Attachments {
    fn new(context: &Context, width: u32, height: u32) -> Result<Self, GpuError> {
        let available = context.device().limits().max_texture_dimension_2d;
        if width.max(height) > available {
            return Err(GpuError::TooLarge {
                what: "a camera image".into(),
                needed: format!("{width} x {height} pixels"),
                available: format!("{available} x {available} pixels"),
            });
        }
        let image = |format| Image::new(context, width, height, format);
        Ok(Self {
            size: (width, height),
            color: image(COLOR_FORMAT),
            distance: image(DISTANCE_FORMAT),
            segment: image(SEGMENT_FORMAT),
            normal: image(NORMAL_FORMAT),
            depth: image(DEPTH_FORMAT),
        })
    }

    /// The images that are read back.
    fn images(&self) -> [&Image; 4] {
        [&self.color, &self.distance, &self.segment, &self.normal]
    }

    fn read_bytes(&self) -> u64 {
        self.images().iter().map(|image| image.read_bytes()).sum()
    }
}

/// An attachment's texture.
#[derive(Debug)]
struct Image {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
}

impl Image {
    fn new(context: &Context, width: u32, height: u32, format: wgpu::TextureFormat) -> Self {
        let texture = context.device().create_texture(&wgpu::TextureDescriptor {
            label: Some("attachment"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Self { texture, view }
    }

    /// Bytes of a row in the read-back memory; copies want them padded.
    fn row_bytes(&self) -> u32 {
        (self.texture.width() * PIXEL_BYTES).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
    }

    fn read_bytes(&self) -> u64 {
        u64::from(self.row_bytes()) * u64::from(self.texture.height())
    }

    fn copy_out(&self, encoder: &mut wgpu::CommandEncoder, target: &wgpu::Buffer, offset: u64) {
        let target = wgpu::TexelCopyBufferInfo {
            buffer: target,
            layout: wgpu::TexelCopyBufferLayout {
                offset,
                bytes_per_row: Some(self.row_bytes()),
                rows_per_image: None,
            },
        };
        encoder.copy_texture_to_buffer(self.texture.as_image_copy(), target, self.texture.size());
    }

    /// The pixels, row by row, without the padding.
    fn pixels<'a>(&self, bytes: &'a [u8]) -> impl Iterator<Item = [u8; 4]> + use<'a> {
        let used = (self.texture.width() * PIXEL_BYTES) as usize;
        bytes
            .chunks_exact(self.row_bytes() as usize)
            .flat_map(move |row| row[..used].as_chunks::<4>().0)
            .copied()
    }
}
