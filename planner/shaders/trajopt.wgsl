// Trajectory optimisation on the constraint manifold. Twin of `trajopt.rs`: Gauss-Newton steps in the null space of the
// constraint, every iterate projected back onto it. One iteration is five passes: `reduce`, `couple`, `solve`, `advance`,
// `accept`; those over waypoints have one invocation for each, the others one for each problem.

struct Waypoint {
    x: array<f32, MAX_VARIABLES>,
    // Terms of the clearance hinges, without their weight.
    gradient: array<f32, MAX_VARIABLES>,
    hessian: array<f32, TRIANGLE>,
    cost: f32,
    largest: f32,
    held: u32,
}

// The linear system's part of one waypoint.
struct Reduced {
    // Orthonormal columns of the directions that keep the constraint.
    basis: array<f32, BASIS>,
    columns: u32,
    // Right-hand side, then the solution.
    right: array<f32, MAX_FREE>,
    // Blocks [row][column] with this waypoint, the next and the one after; then their Cholesky factors.
    own: array<f32, BLOCK>,
    next: array<f32, BLOCK>,
    second: array<f32, BLOCK>,
}

struct Settings {
    waypoints: u32,
    iterations: u32,
    clearance_m: f32,
    min_clearance_m: f32,
}

// Two for each waypoint of each problem: the current path's and the trial's.
@group(1) @binding(3) var<storage, read_write> waypoints: array<Waypoint>;
@group(1) @binding(4) var<storage, read_write> reduced: array<Reduced>;
@group(1) @binding(5) var<uniform> settings: Settings;

fn at_slot(problem: u32, t: u32, slot: u32) -> u32 {
    return (problem * settings.waypoints + t) * 2u + slot;
}

fn clearance_weight(round: u32) -> f32 {
    if round == 0u {
        return CLEARANCE_WEIGHT_0;
    }
    return select(CLEARANCE_WEIGHT_2, CLEARANCE_WEIGHT_1, round == 1u);
}

// How far a variable is beyond the margin of its lower (x) and upper (y) limit; not positive within.
fn limit_hinges(joint: Joint, value: f32) -> vec2<f32> {
    return vec2(joint.lower + LIMIT_MARGIN - value, value - (joint.upper - LIMIT_MARGIN));
}

// Writes the clearance terms at `q` and `nodes`.
fn write_terms(first: u32, dof: u32, at: u32) {
    drive(q[dof - 1u]);
    penalise(first, dof, settings.clearance_m);
    waypoints[at].gradient = gradient;
    waypoints[at].hessian = hessian;
    waypoints[at].cost = hinge_cost;
    waypoints[at].largest = largest_hinge;
}

// Brings `q` onto the constraint by Newton steps of least weighted norm. True where it is held.
fn project(problem: u32, hold_object: bool) -> bool {
    let first = problems[problem].first_joint;
    let dof = problems[problem].dof;
    let node = problems[problem].end_node;
    let node_from_end = problems[problem].node_from_end;
    let goal = problems[problem].world_from_goal;
    for (var step = 0u; step <= PROJECTION_STEPS; step++) {
        forward(first, dof);
        let end = compose(nodes[node], node_from_end);
        measure(end, goal);
        let size = max(
            max(max(abs(off_linear.x), abs(off_linear.y)), abs(off_linear.z)),
            max(max(abs(off_angular.x), abs(off_angular.y)), abs(off_angular.z)),
        );
        if size < DEVICE_TOLERANCE {
            return true;
        }
        if !(size < 5.0) || step == PROJECTION_STEPS {
            return false;
        }
        linearise(first, dof, node, end.origin);
        for (var i = 0u; i < dof; i++) {
            var scale = joints[first + i].mobility;
            if hold_object && i + 1u == dof {
                scale = 0.0;
            }
            linear[i] *= scale;
            angular[i] *= scale;
        }
        factorise(dof, 1e-7);
        solve_normal();
        var longest = 1e-12;
        for (var i = 0u; i < dof; i++) {
            longest = max(longest, abs(dot(linear[i], off_linear) + dot(angular[i], off_angular)));
        }
        let shrink = min(0.6 / longest, 1.0);
        for (var i = 0u; i < dof; i++) {
            // The columns are scaled already: zero where the object's joint is held.
            let joint = joints[first + i];
            let wanted = dot(linear[i], off_linear) + dot(angular[i], off_angular);
            q[i] = clamp(q[i] - joint.mobility * wanted * shrink, joint.lower, joint.upper);
        }
    }
    return false;
}

// Clearance terms of the paths to begin with.
@compute @workgroup_size(WORKGROUP)
fn evaluate(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x / settings.waypoints;
    let t = id.x % settings.waypoints;
    if problem >= arrayLength(&problems) {
        return;
    }
    let at = at_slot(problem, t, 0u);
    q = waypoints[at].x;
    forward(problems[problem].first_joint, problems[problem].dof);
    write_terms(problems[problem].first_joint, problems[problem].dof, at);
    waypoints[at].held = 1u;
    // The first waypoint never changes, the others of the trial do before they are read.
    if t == 0u {
        waypoints[at + 1u] = waypoints[at];
    }
}

// `sum |W_v dx|^2 + sum |W_a d(dx)|^2`, at rest before the first and after the last waypoint, and all hinges.
fn total_cost(problem: u32, slot: u32, weight: f32) -> f32 {
    let first = problems[problem].first_joint;
    let dof = problems[problem].dof;
    var sum = 0.0;
    for (var i = 0u; i < dof; i++) {
        let joint = joints[first + i];
        var before = waypoints[at_slot(problem, 0u, slot)].x[i];
        var before_step = 0.0;
        for (var t = 0u; t < settings.waypoints; t++) {
            let at = at_slot(problem, t, slot);
            let x = waypoints[at].x[i];
            let step = x - before;
            let bend = step - before_step;
            sum += joint.velocity_weight * step * step;
            // The bend at t - 1; at t = 0 both steps are zero.
            sum += joint.acceleration_weight * bend * bend;
            before = x;
            before_step = step;
            if i + 1u < dof {
                let hinges = max(limit_hinges(joint, x), vec2(0.0));
                sum += LIMIT_WEIGHT * dot(hinges, hinges);
            }
        }
        sum += joint.acceleration_weight * before_step * before_step;
    }
    for (var t = 0u; t < settings.waypoints; t++) {
        sum += weight * waypoints[at_slot(problem, t, slot)].cost;
    }
    return sum;
}

fn largest_of_path(problem: u32, slot: u32) -> f32 {
    var largest = 0.0;
    for (var t = 0u; t < settings.waypoints; t++) {
        largest = max(largest, waypoints[at_slot(problem, t, slot)].largest);
    }
    return largest;
}

fn begin_round(problem: u32, round: u32) {
    problems[problem].round = round;
    problems[problem].iteration = 0u;
    problems[problem].damping = 1e-3;
    problems[problem].cost = total_cost(problem, problems[problem].slot, clearance_weight(round));
}

@compute @workgroup_size(PROBLEM_WORKGROUP)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x;
    if problem >= arrayLength(&problems) {
        return;
    }
    if largest_of_path(problem, 0u) > HOPELESS_START_M || settings.iterations == 0u {
        problems[problem].done = 1u;
        return;
    }
    begin_round(problem, 0u);
}

// `x[t]`'s derivative of half the smoothness terms of one variable, and half their second derivative.
fn smoothness(problem: u32, slot: u32, t: u32, i: u32, joint: Joint) -> vec2<f32> {
    let last = settings.waypoints - 1u;
    let before2 = waypoints[at_slot(problem, t - min(t, 2u), slot)].x[i];
    let before = waypoints[at_slot(problem, t - 1u, slot)].x[i];
    let x = waypoints[at_slot(problem, t, slot)].x[i];
    let after = waypoints[at_slot(problem, min(t + 1u, last), slot)].x[i];
    let after2 = waypoints[at_slot(problem, min(t + 2u, last), slot)].x[i];
    let here = (after - x) - (x - before);
    let previous = (x - before) - (before - before2);
    let following = (after2 - after) - (after - x);
    if t == last {
        let bends = previous - here;
        return vec2(
            joint.velocity_weight * (x - before) + joint.acceleration_weight * bends,
            joint.velocity_weight + 2.0 * joint.acceleration_weight,
        );
    }
    return vec2(
        -joint.velocity_weight * here + joint.acceleration_weight * (previous - 2.0 * here + following),
        2.0 * joint.velocity_weight + 6.0 * joint.acceleration_weight,
    );
}

// Columns to be orthogonal to, then the reflectors.
var<private> columns: array<f32, CONSTRAINTS>;

fn column_norm(c: u32, from_row: u32, dof: u32) -> f32 {
    var sum = 0.0;
    for (var r = from_row; r < dof; r++) {
        sum += columns[c * MAX_VARIABLES + r] * columns[c * MAX_VARIABLES + r];
    }
    return sqrt(sum);
}

// Writes an orthonormal basis of the directions that keep the constraint (Jacobian in `linear` and `angular`) by
// Householder reflections with column pivoting. Gives the number of its columns.
fn write_null_space(at: u32, dof: u32, hold_object: bool) -> u32 {
    let count = select(6u, 7u, hold_object);
    for (var r = 0u; r < dof; r++) {
        for (var c = 0u; c < 6u; c++) {
            columns[c * MAX_VARIABLES + r] = component(r, c);
        }
        columns[6u * MAX_VARIABLES + r] = select(0.0, 1.0, r + 1u == dof);
    }
    var rank = 0u;
    for (var c = 0u; c < min(count, dof); c++) {
        var pivot = c;
        var length = 0.0;
        for (var other = c; other < count; other++) {
            let norm = column_norm(other, c, dof);
            if norm > length {
                length = norm;
                pivot = other;
            }
        }
        if length < 1e-5 {
            break;
        }
        for (var r = 0u; r < dof; r++) {
            let kept = columns[c * MAX_VARIABLES + r];
            columns[c * MAX_VARIABLES + r] = columns[pivot * MAX_VARIABLES + r];
            columns[pivot * MAX_VARIABLES + r] = kept;
        }
        // The reflector takes the column's place, from its diagonal on.
        let diagonal = columns[c * MAX_VARIABLES + c];
        columns[c * MAX_VARIABLES + c] += select(-length, length, diagonal >= 0.0);
        let norm = column_norm(c, c, dof);
        for (var r = c; r < dof; r++) {
            columns[c * MAX_VARIABLES + r] /= norm;
        }
        for (var other = c + 1u; other < count; other++) {
            reflect(c, other, dof);
        }
        rank += 1u;
    }
    let free = min(dof - rank, MAX_FREE);
    for (var c = 0u; c < free; c++) {
        for (var r = 0u; r < dof; r++) {
            row[r] = select(0.0, 1.0, r == rank + c);
        }
        for (var back = 0u; back < rank; back++) {
            let v = (rank - 1u - back) * MAX_VARIABLES;
            var sum = 0.0;
            for (var r = rank - 1u - back; r < dof; r++) {
                sum += columns[v + r] * row[r];
            }
            for (var r = rank - 1u - back; r < dof; r++) {
                row[r] -= 2.0 * sum * columns[v + r];
            }
        }
        for (var r = 0u; r < dof; r++) {
            reduced[at].basis[c * MAX_VARIABLES + r] = row[r];
        }
    }
    return free;
}

// Reflects a column by the reflector in column `by`.
fn reflect(by: u32, other: u32, dof: u32) {
    var sum = 0.0;
    for (var r = by; r < dof; r++) {
        sum += columns[by * MAX_VARIABLES + r] * columns[other * MAX_VARIABLES + r];
    }
    for (var r = by; r < dof; r++) {
        columns[other * MAX_VARIABLES + r] -= 2.0 * sum * columns[by * MAX_VARIABLES + r];
    }
}

// The waypoint's null space, and what it alone adds to the linear system.
@compute @workgroup_size(WORKGROUP)
fn reduce(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x / settings.waypoints;
    let t = id.x % settings.waypoints;
    if problem >= arrayLength(&problems) || t == 0u || problems[problem].done == 1u {
        return;
    }
    let first = problems[problem].first_joint;
    let dof = problems[problem].dof;
    let node = problems[problem].end_node;
    let slot = problems[problem].slot;
    let damping = problems[problem].damping;
    let weight = clearance_weight(problems[problem].round);
    let at = at_slot(problem, t, slot);
    q = waypoints[at].x;
    forward(first, dof);
    linearise(first, dof, node, place(nodes[node], problems[problem].node_from_end.origin));
    let free = write_null_space(id.x, dof, t + 1u == settings.waypoints);
    reduced[id.x].columns = free;

    // Gradient, and what the diagonal of the Hessian has beside the clearance terms.
    var slope: array<f32, MAX_VARIABLES>;
    var diagonal: array<f32, MAX_VARIABLES>;
    for (var i = 0u; i < dof; i++) {
        let joint = joints[first + i];
        let smooth_terms = smoothness(problem, slot, t, i, joint);
        slope[i] = weight * waypoints[at].gradient[i] + smooth_terms.x;
        diagonal[i] = smooth_terms.y + damping * (joint.velocity_weight + joint.acceleration_weight);
        if i + 1u < dof {
            let hinges = limit_hinges(joint, q[i]);
            if hinges.x > 0.0 {
                slope[i] -= LIMIT_WEIGHT * hinges.x;
                diagonal[i] += LIMIT_WEIGHT;
            }
            if hinges.y > 0.0 {
                slope[i] += LIMIT_WEIGHT * hinges.y;
                diagonal[i] += LIMIT_WEIGHT;
            }
        }
    }
    hessian = waypoints[at].hessian;
    for (var c = 0u; c < free; c++) {
        var along = 0.0;
        for (var i = 0u; i < dof; i++) {
            let by = reduced[id.x].basis[c * MAX_VARIABLES + i];
            along += by * slope[i];
            gradient[i] = by;
            row[i] = diagonal[i] * by;
        }
        reduced[id.x].right[c] = -along;
        var entry = 0u;
        for (var i = 0u; i < dof; i++) {
            for (var j = 0u; j < i; j++) {
                let h = weight * hessian[entry + j];
                row[i] += h * gradient[j];
                row[j] += h * gradient[i];
            }
            row[i] += weight * hessian[entry + i] * gradient[i];
            entry += i + 1u;
        }
        for (var r = c; r < free; r++) {
            var sum = 0.0;
            for (var i = 0u; i < dof; i++) {
                sum += reduced[id.x].basis[r * MAX_VARIABLES + i] * row[i];
            }
            reduced[id.x].own[r * MAX_FREE + c] = sum;
        }
    }
}

// Blocks with the next two waypoints: the smoothness terms between them.
@compute @workgroup_size(WORKGROUP)
fn couple(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x / settings.waypoints;
    let t = id.x % settings.waypoints;
    if problem >= arrayLength(&problems) || t == 0u || problems[problem].done == 1u {
        return;
    }
    let first = problems[problem].first_joint;
    let dof = problems[problem].dof;
    // What bends share with the next waypoint; the last one's has one term less.
    let shared_bends = select(4.0, 3.0, t + 2u == settings.waypoints);
    for (var gap = 1u; gap <= 2u && t + gap < settings.waypoints; gap++) {
        let rows = reduced[id.x + gap].columns;
        let count = reduced[id.x].columns;
        for (var c = 0u; c < count; c++) {
            for (var i = 0u; i < dof; i++) {
                let joint = joints[first + i];
                let next = -joint.velocity_weight - shared_bends * joint.acceleration_weight;
                row[i] = select(joint.acceleration_weight, next, gap == 1u)
                    * reduced[id.x].basis[c * MAX_VARIABLES + i];
            }
            for (var r = 0u; r < rows; r++) {
                var sum = 0.0;
                for (var i = 0u; i < dof; i++) {
                    sum += reduced[id.x + gap].basis[r * MAX_VARIABLES + i] * row[i];
                }
                if gap == 1u {
                    reduced[id.x].next[r * MAX_FREE + c] = sum;
                } else {
                    reduced[id.x].second[r * MAX_FREE + c] = sum;
                }
            }
        }
    }
}

// Cholesky factorisation by blocks of the band matrix, and the solution of the linear system.
@compute @workgroup_size(PROBLEM_WORKGROUP)
fn solve(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x;
    if problem >= arrayLength(&problems) || problems[problem].done == 1u {
        return;
    }
    let count = settings.waypoints;
    let first = problem * count;
    problems[problem].failed = 0u;
    for (var t = 1u; t < count; t++) {
        let at = first + t;
        let size = reduced[at].columns;
        // What the two waypoints before leave of this one's blocks.
        if t >= 3u {
            subtract_second(at, size);
        }
        if t >= 2u {
            subtract_next(at, size, t + 1u < count);
        }
        for (var i = 0u; i < size; i++) {
            for (var j = 0u; j <= i; j++) {
                var sum = reduced[at].own[i * MAX_FREE + j];
                for (var k = 0u; k < j; k++) {
                    sum -= reduced[at].own[i * MAX_FREE + k] * reduced[at].own[j * MAX_FREE + k];
                }
                if i == j {
                    if !(sum > 0.0) || !(sum < 1e30) {
                        problems[problem].failed = 1u;
                        return;
                    }
                    reduced[at].own[i * MAX_FREE + i] = sqrt(sum);
                } else {
                    reduced[at].own[i * MAX_FREE + j] = sum / reduced[at].own[j * MAX_FREE + j];
                }
            }
            var sum = reduced[at].right[i];
            for (var k = 0u; k < i; k++) {
                sum -= reduced[at].own[i * MAX_FREE + k] * reduced[at].right[k];
            }
            reduced[at].right[i] = sum / reduced[at].own[i * MAX_FREE + i];
        }
        for (var j = 0u; j < size; j++) {
            let pivot = 1.0 / reduced[at].own[j * MAX_FREE + j];
            if t + 1u < count {
                for (var i = 0u; i < reduced[at + 1u].columns; i++) {
                    var sum = reduced[at].next[i * MAX_FREE + j];
                    for (var k = 0u; k < j; k++) {
                        sum -= reduced[at].next[i * MAX_FREE + k] * reduced[at].own[j * MAX_FREE + k];
                    }
                    reduced[at].next[i * MAX_FREE + j] = sum * pivot;
                }
            }
            if t + 2u < count {
                for (var i = 0u; i < reduced[at + 2u].columns; i++) {
                    var sum = reduced[at].second[i * MAX_FREE + j];
                    for (var k = 0u; k < j; k++) {
                        sum -= reduced[at].second[i * MAX_FREE + k] * reduced[at].own[j * MAX_FREE + k];
                    }
                    reduced[at].second[i * MAX_FREE + j] = sum * pivot;
                }
            }
        }
    }
    for (var back = 1u; back < count; back++) {
        let t = count - back;
        let at = first + t;
        let size = reduced[at].columns;
        for (var later = 0u; later < size; later++) {
            let i = size - 1u - later;
            var sum = reduced[at].right[i];
            for (var k = i + 1u; k < size; k++) {
                sum -= reduced[at].own[k * MAX_FREE + i] * reduced[at].right[k];
            }
            if t + 1u < count {
                for (var k = 0u; k < reduced[at + 1u].columns; k++) {
                    sum -= reduced[at].next[k * MAX_FREE + i] * reduced[at + 1u].right[k];
                }
            }
            if t + 2u < count {
                for (var k = 0u; k < reduced[at + 2u].columns; k++) {
                    sum -= reduced[at].second[k * MAX_FREE + i] * reduced[at + 2u].right[k];
                }
            }
            reduced[at].right[i] = sum / reduced[at].own[i * MAX_FREE + i];
        }
    }
}

// Takes the factor that links a waypoint with the one two before out of its own block and right-hand side.
fn subtract_second(at: u32, size: u32) {
    let from_columns = reduced[at - 2u].columns;
    for (var k = 0u; k < from_columns; k++) {
        let solved = reduced[at - 2u].right[k];
        for (var i = 0u; i < size; i++) {
            let by = reduced[at - 2u].second[i * MAX_FREE + k];
            reduced[at].right[i] -= by * solved;
            for (var j = 0u; j <= i; j++) {
                reduced[at].own[i * MAX_FREE + j] -= by * reduced[at - 2u].second[j * MAX_FREE + k];
            }
        }
    }
}

// The same for the waypoint before, which is linked with the next one as well.
fn subtract_next(at: u32, size: u32, has_next: bool) {
    let from_columns = reduced[at - 1u].columns;
    for (var k = 0u; k < from_columns; k++) {
        let solved = reduced[at - 1u].right[k];
        for (var i = 0u; i < size; i++) {
            let by = reduced[at - 1u].next[i * MAX_FREE + k];
            reduced[at].right[i] -= by * solved;
            for (var j = 0u; j <= i; j++) {
                reduced[at].own[i * MAX_FREE + j] -= by * reduced[at - 1u].next[j * MAX_FREE + k];
            }
        }
        if has_next {
            for (var i = 0u; i < reduced[at + 1u].columns; i++) {
                let by = reduced[at - 1u].second[i * MAX_FREE + k];
                for (var j = 0u; j < size; j++) {
                    reduced[at].next[i * MAX_FREE + j] -= by * reduced[at - 1u].next[j * MAX_FREE + k];
                }
            }
        }
    }
}

// Steps every waypoint but the first into the trial's slot, projects it and writes its terms.
@compute @workgroup_size(WORKGROUP)
fn advance(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x / settings.waypoints;
    let t = id.x % settings.waypoints;
    if problem >= arrayLength(&problems) || t == 0u {
        return;
    }
    if problems[problem].done == 1u || problems[problem].failed == 1u {
        return;
    }
    let first = problems[problem].first_joint;
    let dof = problems[problem].dof;
    let slot = problems[problem].slot;
    q = waypoints[at_slot(problem, t, slot)].x;
    for (var i = 0u; i < dof; i++) {
        var along = 0.0;
        for (var c = 0u; c < reduced[id.x].columns; c++) {
            along += reduced[id.x].basis[c * MAX_VARIABLES + i] * reduced[id.x].right[c];
        }
        let joint = joints[first + i];
        q[i] = clamp(q[i] + clamp(along, -LONGEST_ADVANCE, LONGEST_ADVANCE), joint.lower, joint.upper);
    }
    let at = at_slot(problem, t, 1u - slot);
    let held = project(problem, t + 1u == settings.waypoints);
    waypoints[at].held = select(0u, 1u, held);
    if held {
        waypoints[at].x = q;
        write_terms(first, dof, at);
    }
}

// Takes the trial where it costs less, and ends rounds as the twin does.
@compute @workgroup_size(PROBLEM_WORKGROUP)
fn accept(@builtin(global_invocation_id) id: vec3<u32>) {
    let problem = id.x;
    if problem >= arrayLength(&problems) || problems[problem].done == 1u {
        return;
    }
    let round = problems[problem].round;
    let slot = problems[problem].slot;
    var over = problems[problem].failed == 1u;
    if !over {
        var held = true;
        for (var t = 1u; t < settings.waypoints; t++) {
            held &= waypoints[at_slot(problem, t, 1u - slot)].held == 1u;
        }
        let cost = problems[problem].cost;
        var trial = cost;
        if held {
            trial = total_cost(problem, 1u - slot, clearance_weight(round));
        }
        if trial < cost {
            problems[problem].slot = 1u - slot;
            problems[problem].cost = trial;
            problems[problem].taken += 1u;
            problems[problem].damping = max(problems[problem].damping * 0.3, 1e-6);
            over = (cost - trial) < LEAST_GAIN * max(cost, 1e-12);
        } else {
            problems[problem].damping *= 8.0;
            over = problems[problem].damping > 1e4;
        }
    }
    problems[problem].iteration += 1u;
    if !over && problems[problem].iteration < settings.iterations {
        return;
    }
    let left = largest_of_path(problem, problems[problem].slot);
    let spare = settings.clearance_m - settings.min_clearance_m;
    if left < 0.8 * spare || left > HOPELESS_M || round + 1u == ROUNDS {
        problems[problem].done = 1u;
        return;
    }
    begin_round(problem, round + 1u);
}
