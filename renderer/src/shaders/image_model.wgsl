// The image model's colour: see the documentation of `scene`. Everything is in the camera frame
// (x right, y down, z forward), so the eye is the origin.

struct Light {
    // Unit direction to a directional light (w = 0), or the position of another (w = 1).
    place: vec4<f32>,
    // Axis of a spot, and the cosine of its outer angle; -2 for other lights.
    axis: vec4<f32>,
    // Linear RGB, and the inverse of what the outer cosine lacks to the inner one.
    rgb: vec4<f32>,
    first_map: u32,
    map_count: u32,
}

struct ShadowMap {
    // Rows of the 3 x 4 matrix light_from_camera, metres.
    row_x: vec4<f32>,
    row_y: vec4<f32>,
    row_z: vec4<f32>,
    focal: f32,
    near_m: f32,
    far_m: f32,
}

// What reflects.
struct Surface {
    albedo: vec3<f32>,
    metallic: f32,
    roughness: f32,
    point: vec3<f32>,
    // Unit, facing the eye.
    normal: vec3<f32>,
}

// Unit normal that faces the eye. `normal` need not be of unit length.
fn facing_normal(point: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let n = normal * inverseSqrt(max(dot(normal, normal), 1e-30));
    return select(n, -n, dot(n, point) > 0.0);
}

fn ambient(upward: f32) -> vec3<f32> {
    return mix(view.ground_rgb, view.sky_rgb, 0.5 * (1.0 + upward));
}

// Linear RGB that a surface sends to the eye.
fn reflected(surface: Surface) -> vec3<f32> {
    let n = surface.normal;
    let to_eye = -normalize(surface.point);
    let cos_eye = max(dot(n, to_eye), 1e-4);
    let upward = dot(n, view.up_direction);
    let diffuse = select(surface.albedo, surface.albedo * (1.0 - surface.metallic), view.pbr == 1u);
    let f0 = mix(vec3(0.04), surface.albedo, surface.metallic);
    var sum = diffuse * ambient(upward);
    if view.pbr == 1u {
        let mirrored = 2.0 * cos_eye * upward - dot(to_eye, view.up_direction);
        let seen = ambient(mix(mirrored, upward, surface.roughness));
        sum += environment_share(f0, cos_eye, surface.roughness) * seen;
    }
    for (var i = 0u; i < view.light_count; i++) {
        let light = view.lights[i];
        var to_light = light.place.xyz;
        var strength = 1.0;
        if light.place.w == 1.0 {
            let way = light.place.xyz - surface.point;
            let square = max(dot(way, way), 1e-6);
            to_light = way * inverseSqrt(square);
            strength = 1.0 / square;
        }
        if light.axis.w > -2.0 {
            let x = clamp((-dot(to_light, light.axis.xyz) - light.axis.w) * light.rgb.w, 0.0, 1.0);
            strength *= x * x * (3.0 - 2.0 * x);
        }
        let facing = dot(n, to_light);
        if facing <= 0.0 || strength <= 0.0 {
            continue;
        }
        var reflectance = surface.albedo;
        if view.pbr == 1u {
            reflectance = ggx(surface, diffuse, f0, to_light, to_eye, facing, cos_eye);
        }
        sum += reflectance * light.rgb.rgb * (strength * facing * lit(light, surface.point, n));
    }
    return sum;
}

// Karis, Physically Based Shading on Mobile, 2014.
fn environment_share(f0: vec3<f32>, cos_eye: f32, roughness: f32) -> vec3<f32> {
    let r = roughness * vec4(-1.0, -0.0275, -0.572, 0.022) + vec4(1.0, 0.0425, 1.04, -0.04);
    let a004 = min(r.x * r.x, exp2(-9.28 * cos_eye)) * r.x + r.y;
    let share = vec2(-1.04, 1.04) * a004 + r.zw;
    return f0 * share.x + share.y;
}

// pi times the metallic-roughness reflectance (glTF 2.0, appendix B).
fn ggx(
    surface: Surface,
    diffuse: vec3<f32>,
    f0: vec3<f32>,
    to_light: vec3<f32>,
    to_eye: vec3<f32>,
    facing: f32,
    cos_eye: f32,
) -> vec3<f32> {
    let alpha = pow(max(surface.roughness, 0.05), 2.0);
    let a2 = alpha * alpha;
    let half = normalize(to_light + to_eye);
    let cos_half = max(dot(surface.normal, half), 0.0);
    let spread = cos_half * cos_half * (a2 - 1.0) + 1.0;
    let masked = facing * sqrt(cos_eye * cos_eye * (1.0 - a2) + a2)
        + cos_eye * sqrt(facing * facing * (1.0 - a2) + a2);
    let specular = a2 / (spread * spread) * 0.5 / max(masked, 1e-6);
    let fresnel = mix(f0, vec3(1.0), pow(1.0 - max(dot(to_eye, half), 0.0), 5.0));
    return diffuse * (1.0 - fresnel) + fresnel * specular;
}

// How much of a light reaches a point: 1 all, 0 nothing.
fn lit(light: Light, point: vec3<f32>, n: vec3<f32>) -> f32 {
    let half = 0.5 * f32(textureDimensions(shadow_maps).x);
    for (var i = light.first_map; i < light.first_map + light.map_count; i++) {
        let map = view.maps[i];
        let at = vec4(point, 1.0);
        var q = vec3(dot(map.row_x, at), dot(map.row_y, at), dot(map.row_z, at));
        if q.z <= 0.0 || max(abs(q.x), abs(q.y)) * map.focal > half * q.z {
            continue;
        }
        let turned = vec3(dot(map.row_x.xyz, n), dot(map.row_y.xyz, n), dot(map.row_z.xyz, n));
        q += view.normal_offset_texels * q.z / map.focal * turned;
        return lit_in_map(map, i, q, half);
    }
    return 1.0;
}

// Share of the four texels around a point that do not hide it, weighted bilinearly.
fn lit_in_map(map: ShadowMap, layer: u32, q: vec3<f32>, half: f32) -> f32 {
    // The map's reversed depth at the receiver: near (far - z) / ((far - near) z).
    let z = max(q.z - view.bias_m, 1e-3);
    let receiver = map.near_m * (map.far_m - z) / ((map.far_m - map.near_m) * z);
    let at = clamp(q.xy / q.z * map.focal + half - 0.5, vec2(0.0), vec2(2.0 * half - 1.0));
    let low = vec2<u32>(floor(at));
    let high = min(low + 1u, vec2(u32(2.0 * half) - 1u));
    let weight = at - floor(at);
    let open = vec4(
        textureLoad(shadow_maps, low, layer, 0),
        textureLoad(shadow_maps, vec2(high.x, low.y), layer, 0),
        textureLoad(shadow_maps, vec2(low.x, high.y), layer, 0),
        textureLoad(shadow_maps, high, layer, 0),
    ) <= vec4(receiver);
    let share = select(vec4(0.0), vec4(1.0), open);
    return mix(mix(share.x, share.y, weight.x), mix(share.z, share.w, weight.x), weight.y);
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

// Twice 16 bits (Cigolle et al., A Survey of Efficient Representations for Independent Unit Vectors, JCGT 2014).
fn octahedral(n: vec3<f32>) -> u32 {
    let p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    let sign = select(vec2(-1.0), vec2(1.0), p >= vec2(0.0));
    let folded = select(p, (1.0 - abs(p.yx)) * sign, n.z < 0.0);
    let code = vec2<u32>(round((folded * 0.5 + 0.5) * 65535.0));
    return code.x | (code.y << 16u);
}
