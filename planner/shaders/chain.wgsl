// Forward kinematics of one configuration for each invocation. Twin of `kernels/chain.rs`: axes are turned to z.

struct Joint {
    // `parent_from_joint`: columns of the rotation, then the origin.
    x: vec3<f32>,
    parent: u32,
    y: vec3<f32>,
    slides: u32,
    z: vec3<f32>,
    lower: f32,
    origin: vec3<f32>,
    upper: f32,
    // Bit i is set where variable i moves this joint's node.
    moved_by: u32,
    velocity_weight: f32,
    acceleration_weight: f32,
    mobility: f32,
}

struct Frame {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
    origin: vec3<f32>,
}

// One kinematic problem: a chain, what hangs from its end, and where that belongs. The rest is the state of optimisation.
struct Problem {
    node_from_end: Frame,
    world_from_goal: Frame,
    first_joint: u32,
    dof: u32,
    end_node: u32,
    // Position of the object's joint where it is not a variable, rad or m.
    object_q: f32,
    // Half of `waypoints` that holds the current path.
    slot: u32,
    round: u32,
    iteration: u32,
    done: u32,
    // The linear system had no solution.
    failed: u32,
    // Steps that were taken.
    taken: u32,
    damping: f32,
    cost: f32,
}

struct Configuration {
    x: array<f32, MAX_VARIABLES>,
    // Squared error of the end (m, rad).
    squared: f32,
    // Smallest clearance, metres.
    clearance: f32,
}

@group(0) @binding(1) var<storage, read> joints: array<Joint>;
@group(1) @binding(0) var<storage, read_write> problems: array<Problem>;
@group(1) @binding(1) var<storage, read_write> configurations: array<Configuration>;
@group(1) @binding(2) var<storage, read_write> poses: array<Frame>;

// The invocation's configuration, and the world frames of its nodes.
var<private> q: array<f32, MAX_VARIABLES>;
var<private> nodes: array<Frame, MAX_VARIABLES>;

// Sine and cosine by polynomials of a quarter of the angle: the built-in ones are as coarse as 2^-11.
fn sin_cos(angle: f32) -> vec2<f32> {
    let turns = floor(angle * 0.15915494 + 0.5);
    let h = (angle - turns * 6.28125 - turns * 0.0019353072) * 0.25;
    let h2 = h * h;
    let sine = h + h * h2 * (((2.7557319e-6 * h2 - 1.984127e-4) * h2 + 8.333333e-3) * h2 - 0.16666667);
    let cosine = 1.0 + h2 * (((2.4801587e-5 * h2 - 1.3888889e-3) * h2 + 0.041666668) * h2 - 0.5);
    return double_angle(double_angle(vec2(sine, cosine)));
}

fn double_angle(half: vec2<f32>) -> vec2<f32> {
    let twice = half.x + half.x;
    return vec2(twice * half.y, 1.0 - twice * half.x);
}

// World components of a direction of a frame.
fn turned(frame: Frame, direction: vec3<f32>) -> vec3<f32> {
    return frame.x * direction.x + frame.y * direction.y + frame.z * direction.z;
}

// World place of a point of a frame.
fn place(frame: Frame, at: vec3<f32>) -> vec3<f32> {
    return turned(frame, at) + frame.origin;
}

// A world point in a frame.
fn inside(frame: Frame, at: vec3<f32>) -> vec3<f32> {
    let offset = at - frame.origin;
    return vec3(dot(frame.x, offset), dot(frame.y, offset), dot(frame.z, offset));
}

fn compose(a: Frame, b: Frame) -> Frame {
    return Frame(turned(a, b.x), turned(a, b.y), turned(a, b.z), place(a, b.origin));
}

// Writes `nodes` at `q`.
fn forward(first_joint: u32, dof: u32) {
    for (var i = 0u; i < dof; i++) {
        let joint = joints[first_joint + i];
        var frame = Frame(joint.x, joint.y, joint.z, joint.origin);
        if joint.parent != NO_NODE {
            frame = compose(nodes[joint.parent], frame);
        }
        if joint.slides == 1u {
            frame.origin += frame.z * q[i];
        } else {
            let turn = sin_cos(q[i]);
            let x = frame.x * turn.y + frame.y * turn.x;
            frame.y = frame.y * turn.y - frame.x * turn.x;
            frame.x = x;
        }
        nodes[i] = frame;
    }
}

// Linear velocity, for each unit of a variable, of a world point that it moves.
fn point_column(first_joint: u32, variable: u32, at: vec3<f32>) -> vec3<f32> {
    let axis = nodes[variable].z;
    if joints[first_joint + variable].slides == 1u {
        return axis;
    }
    return cross(axis, at - nodes[variable].origin);
}

// Frames of all nodes of all configurations.
@compute @workgroup_size(WORKGROUP)
fn forward_all(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&configurations) {
        return;
    }
    q = configurations[id.x].x;
    let dof = problems[0].dof;
    forward(problems[0].first_joint, dof);
    for (var i = 0u; i < dof; i++) {
        poses[id.x * MAX_VARIABLES + i] = nodes[i];
    }
}
