//! A rig in words.

use crate::pipeline::{CameraSurvey, Survey, ViewSurvey};

/// Cameras one by one.
pub fn text(survey: &Survey) -> String {
    let mut lines = vec![match &survey.trajectory {
        Some(id) => format!("rig \"{}\" on trajectory {id}", survey.rig),
        None => format!("rig \"{}\"", survey.rig),
    }];
    for camera in &survey.cameras {
        lines.push(format!("  {}: {}", camera.name, optics(camera)));
        lines.push(format!("    {}", camera.mount));
        if let Some(view) = &camera.view {
            lines.extend(seen(view).into_iter().map(|line| format!("    {line}")));
        }
    }
    lines.join("\n")
}

fn optics(camera: &CameraSurvey) -> String {
    let [width, height] = camera.size;
    let [[fx, _, cx], [_, fy, cy], _] = camera.k;
    let [across, down] = camera.field_of_view_rad.map(f64::to_degrees);
    format!(
        "{width} x {height} pixels, {across:.1} x {down:.1} degrees, fx {fx:.2} fy {fy:.2} cx {cx:.2} \
         cy {cy:.2}, {}",
        camera.distortion_model
    )
}

fn seen(view: &ViewSurvey) -> Vec<String> {
    let place = |pose: &[f64; 7]| format!("({:.2}, {:.2}, {:.2})", pose[0], pose[1], pose[2]);
    let [from, to] = [&view.world_from_camera_first, &view.world_from_camera_last].map(place);
    let moved = if from == to { format!("at {from}") } else { format!("from {from} to {to}") };
    let [near, median, far] = view.depth_m;
    let mut lines = vec![
        format!(
            "{moved} m, {:.2} to {:.2} m from the handle",
            view.handle_distance_m[0], view.handle_distance_m[1]
        ),
        format!(
            "handle visible in {:.0} % of the frames, occluded in {:.0} %, out of view in {:.0} %",
            1e2 * view.handle_visible,
            1e2 * view.handle_occluded,
            1e2 * view.handle_out_of_view
        ),
        format!(
            "depth valid in {:.0} % of the pixels, {near:.2} to {far:.2} m, median {median:.2} m",
            1e2 * view.valid_depth
        ),
    ];
    let shares: Vec<String> = view
        .sees
        .iter()
        .take(8)
        .map(|(name, share)| format!("{name} {:.0} %", 1e2 * share))
        .collect();
    lines.push(format!("sees {}", shares.join(", ")));
    lines.extend(view.problem.iter().map(|problem| format!("PROBLEM {problem}")));
    lines
}
