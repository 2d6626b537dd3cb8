//! A scene as USD text (`.usda`): one Xform a body, meshes with normals and display colours. Z up, metres.

use std::fmt::Write as _;

use super::PlacedBody;
use super::gltf::base_color;
use crate::finish::Finish;
use crate::solid::Solid;
use crate::texture::Texture;

/// The file. Writing to a `String` cannot fail, so its results are dropped.
pub fn usda(name: &str, bodies: &[PlacedBody]) -> String {
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"{name}\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"{name}\" (\n    kind = \"assembly\"\n)\n{{\n"
    );
    for body in bodies {
        let (t, q) = (body.world_from_body.translation, body.world_from_body.rotation);
        let _ = writeln!(
            text,
            "    def Xform \"{}\" (\n        kind = \"component\"\n    )\n    {{\n        custom string akrobat:class = \"{}\"\n        double3 xformOp:translate = ({:.6}, {:.6}, {:.6})\n        quatd xformOp:orient = ({:.9}, {:.9}, {:.9}, {:.9})\n        uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]",
            body.name, body.class, t.x, t.y, t.z, q.w, q.i, q.j, q.k
        );
        for (index, visual) in body.link.visuals.iter().enumerate() {
            for (part, solid) in visual.solids.iter().enumerate() {
                push_mesh(&mut text, &format!("mesh_{index}_{part}"), solid, &visual.finish);
            }
        }
        text.push_str("    }\n");
    }
    text.push_str("}\n");
    text
}

fn push_mesh(text: &mut String, name: &str, solid: &Solid, finish: &Finish) {
    let points: Vec<String> =
        solid.positions.iter().map(|p| format!("({:.6}, {:.6}, {:.6})", p.x, p.y, p.z)).collect();
    let indices: Vec<String> = solid
        .triangles
        .iter()
        .map(|t| format!("{}, {}, {}", t[0].position, t[1].position, t[2].position))
        .collect();
    let [r, g, b] = display_color(finish);
    let _ = writeln!(
        text,
        "        def Mesh \"{name}\"\n        {{\n            uniform token subdivisionScheme = \"none\"\n            int[] faceVertexCounts = [{}]\n            int[] faceVertexIndices = [{}]\n            point3f[] points = [{}]\n            color3f[] primvars:displayColor = [({r:.4}, {g:.4}, {b:.4})]\n        }}",
        vec!["3"; solid.triangles.len()].join(", "),
        indices.join(", "),
        points.join(", "),
    );
}

/// Linear RGB; a texture's mean tone.
pub(super) fn display_color(finish: &Finish) -> [f64; 3] {
    let toned = finish.texture.map(|texture| match texture {
        Texture::Wood { tone, .. }
        | Texture::Tiles { tone, .. }
        | Texture::Brushed { tone, .. } => Finish { color: tone, texture: None, ..finish.clone() },
    });
    let [r, g, b, _] = base_color(toned.as_ref().unwrap_or(finish));
    [r, g, b]
}
