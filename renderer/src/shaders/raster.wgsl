// Draws bodies into colour, z-depth and segmentation.

struct View {
    // Normalised device x = scale.x * x / z + offset.x, and y likewise (counted downwards).
    scale: vec2<f32>,
    offset: vec2<f32>,
    near_m: f32,
    far_m: f32,
    light_count: u32,
    // 1 for metallic-roughness reflection, 0 for Lambert's.
    pbr: u32,
    // Unit direction of the world's z axis, and the ambient light on surfaces facing it and facing away.
    up_direction: vec3<f32>,
    sky_rgb: vec3<f32>,
    ground_rgb: vec3<f32>,
    bias_m: f32,
    normal_offset_texels: f32,
    lights: array<Light, 8>,
    maps: array<ShadowMap, 48>,
}

struct Material {
    // Linear RGB.
    base_color: vec3<f32>,
    metallic: f32,
    roughness: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var shadow_maps: texture_depth_2d_array;
@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var base_color_texture: texture_2d<f32>;

struct Vertex {
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
}

struct Body {
    // Rows of the 3 x 4 matrix camera_from_body, metres.
    @location(3) row_x: vec4<f32>,
    @location(4) row_y: vec4<f32>,
    @location(5) row_z: vec4<f32>,
    @location(6) segment_id: u32,
}

struct Corner {
    @builtin(position) clip: vec4<f32>,
    @location(0) point: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) uv: vec2<f32>,
    @location(3) @interpolate(flat) segment_id: u32,
}

struct Pixel {
    @location(0) srgb: vec4<f32>,
    @location(1) depth_m: f32,
    @location(2) segment_id: u32,
    @location(3) normal: u32,
}

@vertex
fn vertex(vertex: Vertex, body: Body) -> Corner {
    let homogeneous = vec4(vertex.position, 1.0);
    let point = vec3(
        dot(body.row_x, homogeneous),
        dot(body.row_y, homogeneous),
        dot(body.row_z, homogeneous),
    );
    var corner: Corner;
    corner.point = point;
    corner.normal = vec3(
        dot(body.row_x.xyz, vertex.normal),
        dot(body.row_y.xyz, vertex.normal),
        dot(body.row_z.xyz, vertex.normal),
    );
    corner.uv = vertex.uv;
    corner.segment_id = body.segment_id;
    let xy = view.scale * point.xy + view.offset * point.z;
    // Reversed depth, 1 at near and 0 at far: spends floating-point precision evenly over the range.
    let depth = view.near_m * (view.far_m - point.z) / (view.far_m - view.near_m);
    corner.clip = vec4(xy.x, -xy.y, depth, point.z);
    return corner;
}

@fragment
fn fragment(corner: Corner) -> Pixel {
    let normal = facing_normal(corner.point, corner.normal);
    let albedo = material.base_color * texture_repeat(base_color_texture, corner.uv);
    let surface =
        Surface(albedo, material.metallic, material.roughness, corner.point, normal);
    var pixel: Pixel;
    pixel.srgb = vec4(srgb_from_linear(reflected(surface)), 1.0);
    pixel.depth_m = corner.point.z;
    pixel.segment_id = corner.segment_id;
    pixel.normal = octahedral(normal);
    return pixel;
}
