// The image model's colour: see the documentation of `scene`. Everything is in the camera frame
// (x right, y down, z forward), so the eye is the origin.

struct Light {
    // Unit direction to the sun, and what it gives to a surface that faces it (linear RGB).
    sun_direction: vec3<f32>,
    sun_rgb: vec3<f32>,
    // Unit direction of the world's z axis, and the ambient light on surfaces facing it and facing away.
    up_direction: vec3<f32>,
    sky_rgb: vec3<f32>,
    ground_rgb: vec3<f32>,
}

// Linear RGB of a surface point. `normal` need not be of unit length nor face the camera.
fn shade(albedo: vec3<f32>, point: vec3<f32>, normal: vec3<f32>, light: Light) -> vec3<f32> {
    var n = normal * inverseSqrt(max(dot(normal, normal), 1e-30));
    if dot(n, point) > 0.0 {
        n = -n;
    }
    let ambient = mix(light.ground_rgb, light.sky_rgb, 0.5 * (1.0 + dot(n, light.up_direction)));
    return albedo * (ambient + light.sun_rgb * max(0.0, dot(n, light.sun_direction)));
}

// IEC 61966-2-1.
fn srgb_from_linear(linear: vec3<f32>) -> vec3<f32> {
    let c = clamp(linear, vec3(0.0), vec3(1.0));
    let low = 12.92 * c;
    let high = 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055;
    return select(high, low, c <= vec3(0.0031308));
}

// Bilinear, repeating, texel centres at half-integer positions. Written out because the precision of
// samplers differs between devices.
fn texture_repeat(image: texture_2d<f32>, uv: vec2<f32>) -> vec3<f32> {
    let size = textureDimensions(image);
    let position = (uv - floor(uv)) * vec2<f32>(size) - 0.5;
    let corner = floor(position);
    let weight = position - corner;
    // `corner` is -1 at least; adding the size keeps the remainder positive.
    let low = (vec2<u32>(vec2<i32>(corner) + vec2<i32>(size))) % size;
    let high = (low + 1u) % size;
    let top = mix(
        textureLoad(image, low, 0).rgb,
        textureLoad(image, vec2(high.x, low.y), 0).rgb,
        weight.x,
    );
    let bottom = mix(
        textureLoad(image, vec2(low.x, high.y), 0).rgb,
        textureLoad(image, high, 0).rgb,
        weight.x,
    );
    return mix(top, bottom, weight.y);
}
