// Inverse kinematics of one seed for each invocation. Twin of `kernels/ik.rs`: Levenberg-Marquardt steps whose damping
// follows the squared error.

// `[translation; rotation]` from the goal to the end, and the Jacobian's columns.
var<private> off_linear: vec3<f32>;
var<private> off_angular: vec3<f32>;
var<private> linear: array<vec3<f32>, MAX_VARIABLES>;
var<private> angular: array<vec3<f32>, MAX_VARIABLES>;
// Lower triangle of a 6 by 6 matrix, then its Cholesky factor with the diagonal inverted.
var<private> normal: array<f32, 36>;

// The rotation as its axis times `2 tan(angle / 2)`.
fn measure(end: Frame, goal: Frame) {
    let vee = cross(goal.x, end.x) + cross(goal.y, end.y) + cross(goal.z, end.z);
    let trace = dot(goal.x, end.x) + dot(goal.y, end.y) + dot(goal.z, end.z);
    off_linear = end.origin - goal.origin;
    off_angular = vee * (2.0 / max(trace + 1.0, 0.1));
}

fn squared_error() -> f32 {
    return dot(off_linear, off_linear) + dot(off_angular, off_angular);
}

// Columns of the geometric Jacobian of the world point `at` that moves with a node.
fn linearise(first_joint: u32, dof: u32, node: u32, at: vec3<f32>) {
    let moved_by = joints[first_joint + node].moved_by;
    for (var i = 0u; i < dof; i++) {
        linear[i] = vec3(0.0);
        angular[i] = vec3(0.0);
        if (moved_by >> i & 1u) == 1u {
            linear[i] = point_column(first_joint, i, at);
            angular[i] = select(nodes[i].z, vec3(0.0), joints[first_joint + i].slides == 1u);
        }
    }
}

fn component(column: u32, k: u32) -> f32 {
    if k < 3u {
        return linear[column][k];
    }
    return angular[column][k - 3u];
}

// Factorises `J J^T + damping I`.
fn factorise(dof: u32, damping: f32) {
    for (var i = 0u; i < 36u; i++) {
        normal[i] = 0.0;
    }
    for (var c = 0u; c < dof; c++) {
        for (var i = 0u; i < 6u; i++) {
            let own = component(c, i);
            for (var j = 0u; j <= i; j++) {
                normal[i * 6u + j] += own * component(c, j);
            }
        }
    }
    for (var i = 0u; i < 6u; i++) {
        for (var j = 0u; j <= i; j++) {
            var sum = normal[i * 6u + j];
            if i == j {
                sum += damping;
            }
            for (var k = 0u; k < j; k++) {
                sum -= normal[i * 6u + k] * normal[j * 6u + k];
            }
            if i == j {
                // Positive but for rounding.
                normal[i * 6u + i] = 1.0 / sqrt(max(sum, 1e-12));
            } else {
                normal[i * 6u + j] = sum * normal[j * 6u + j];
            }
        }
    }
}

// Solves `(J J^T + damping I) y = error` with the factor; y takes the error's place.
fn solve_normal() {
    var y = array<f32, 6>(
        off_linear.x, off_linear.y, off_linear.z, off_angular.x, off_angular.y, off_angular.z,
    );
    for (var i = 0u; i < 6u; i++) {
        for (var k = 0u; k < i; k++) {
            y[i] -= normal[i * 6u + k] * y[k];
        }
        y[i] *= normal[i * 6u + i];
    }
    for (var back = 0u; back < 6u; back++) {
        let i = 5u - back;
        for (var k = i + 1u; k < 6u; k++) {
            y[i] -= normal[k * 6u + i] * y[k];
        }
        y[i] *= normal[i * 6u + i];
    }
    off_linear = vec3(y[0], y[1], y[2]);
    off_angular = vec3(y[3], y[4], y[5]);
}

// Moves the end of each configuration to the goal.
@compute @workgroup_size(WORKGROUP)
fn solve_ik(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&configurations) {
        return;
    }
    q = configurations[id.x].x;
    let node_from_end = problems[0].node_from_end;
    let goal = problems[0].world_from_goal;
    let first = problems[0].first_joint;
    let dof = problems[0].dof;
    let node = problems[0].end_node;
    var squared = 0.0;
    for (var step = 0u; step < MAX_STEPS; step++) {
        forward(first, dof);
        let end = compose(nodes[node], node_from_end);
        measure(end, goal);
        squared = squared_error();
        // False for what is not a number, too.
        if !(squared >= CONVERGED) {
            break;
        }
        linearise(first, dof, node, end.origin);
        for (var i = 0u; i < dof; i++) {
            // A variable at a limit that the step would leave stays.
            let slope = dot(linear[i], off_linear) + dot(angular[i], off_angular);
            let joint = joints[first + i];
            if (q[i] <= joint.lower && slope > 0.0) || (q[i] >= joint.upper && slope < 0.0) {
                linear[i] = vec3(0.0);
                angular[i] = vec3(0.0);
            }
        }
        factorise(dof, squared * DAMPING_PER_ERROR + LEAST_DAMPING);
        solve_normal();
        for (var i = 0u; i < dof; i++) {
            let wanted = dot(linear[i], off_linear) + dot(angular[i], off_angular);
            let moved = q[i] - clamp(wanted, -LONGEST_STEP, LONGEST_STEP);
            q[i] = clamp(moved, joints[first + i].lower, joints[first + i].upper);
        }
    }
    configurations[id.x].x = q;
    configurations[id.x].squared = squared;
    configurations[id.x].clearance = -1.0;
}
