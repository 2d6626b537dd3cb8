//! L-BFGS with a line search over a few fixed step lengths.

/// How far to go.
#[derive(Debug, Clone, Copy)]
pub struct Settings<'a> {
    /// Iterations; there is no other end.
    pub iterations: usize,
    /// Steps that the Hessian is estimated from; at least one.
    pub history: usize,
    /// Step lengths that are tried, ascending.
    pub step_lengths: &'a [f64],
    /// Largest change of a variable in one iteration.
    pub longest_step: f64,
}

/// Constants of the Wolfe conditions (Nocedal and Wright, *Numerical Optimization*, 2006, section 3.1).
const SUFFICIENT_DECREASE: f64 = 1e-5;
const CURVATURE: f64 = 0.9;

/// A step and the change of gradient over it.
struct Update {
    step: Vec<f64>,
    change: Vec<f64>,
    inverse_product: f64,
}

/// Minimises `cost`, which writes its gradient, from `x` in place; gives the least cost found (Nocedal and Wright, section 7.2). The longest step
/// that fulfils both Wolfe conditions is taken, else the longest with sufficient decrease, else the shortest, as
/// cuRobo does (Sundaralingam et al., *cuRobo: Parallelized Collision-Free Minimum-Jerk Robot Motion Generation*, 2023).
pub fn minimise(
    settings: &Settings<'_>,
    x: &mut [f64],
    cost: &mut dyn FnMut(&[f64], &mut [f64]) -> f64,
) -> f64 {
    let mut gradient = vec![0.0; x.len()];
    let mut at = x.to_vec();
    let mut value = cost(&at, &mut gradient);
    let mut least = value;
    let mut updates: Vec<Update> = Vec::new();
    for _ in 0..settings.iterations {
        let direction = direction(&gradient, &updates, settings.longest_step);
        let slope = dot(&direction, &gradient);
        let mut chosen: Option<(u8, Vec<f64>, Vec<f64>, f64)> = None;
        for &length in settings.step_lengths {
            let trial: Vec<f64> = at.iter().zip(&direction).map(|(x, d)| x + length * d).collect();
            let mut trial_gradient = vec![0.0; x.len()];
            let trial_value = cost(&trial, &mut trial_gradient);
            let decreases = trial_value <= value + SUFFICIENT_DECREASE * length * slope;
            let flattens = dot(&direction, &trial_gradient).abs() <= CURVATURE * slope.abs();
            let rank = u8::from(decreases) + u8::from(decreases && flattens);
            if chosen.as_ref().is_none_or(|(best, ..)| rank >= (*best).max(1)) {
                chosen = Some((rank, trial, trial_gradient, trial_value));
            }
        }
        let Some((_, next, next_gradient, next_value)) = chosen else { break };
        remember(&mut updates, settings.history, (&at, &next), (&gradient, &next_gradient));
        at = next;
        (gradient, value) = (next_gradient, next_value);
        if value < least {
            least = value;
            x.copy_from_slice(&at);
        }
    }
    least
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The two-loop recursion; no component is longer than `longest`.
fn direction(gradient: &[f64], updates: &[Update], longest: f64) -> Vec<f64> {
    let mut d: Vec<f64> = gradient.iter().map(|g| -g).collect();
    let mut shares = Vec::with_capacity(updates.len());
    for update in updates.iter().rev() {
        let share = update.inverse_product * dot(&update.step, &d);
        d.iter_mut().zip(&update.change).for_each(|(d, c)| *d -= share * c);
        shares.push(share);
    }
    if let Some(last) = updates.last() {
        let scale = 1.0 / (last.inverse_product * dot(&last.change, &last.change));
        d.iter_mut().for_each(|d| *d *= scale);
    }
    for (update, share) in updates.iter().zip(shares.into_iter().rev()) {
        let back = share - update.inverse_product * dot(&update.change, &d);
        d.iter_mut().zip(&update.step).for_each(|(d, s)| *d += back * s);
    }
    let largest = d.iter().fold(0.0f64, |a, d| a.max(d.abs()));
    if largest > longest {
        d.iter_mut().for_each(|d| *d *= longest / largest);
    }
    d
}

fn remember(
    updates: &mut Vec<Update>,
    history: usize,
    (x, next): (&[f64], &[f64]),
    (gradient, next_gradient): (&[f64], &[f64]),
) {
    let difference =
        |a: &[f64], b: &[f64]| -> Vec<f64> { b.iter().zip(a).map(|(b, a)| b - a).collect() };
    let (step, change) = (difference(x, next), difference(gradient, next_gradient));
    let product = dot(&step, &change);
    // Where the cost curves downwards, the estimate would lose its positive definiteness.
    if product > 1e-12 * dot(&step, &step) {
        if updates.len() >= history.max(1) {
            updates.remove(0);
        }
        updates.push(Update { step, change, inverse_product: 1.0 / product });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley; its minimum is 0 at (1, 1).
    fn rosenbrock(x: &[f64], gradient: &mut [f64]) -> f64 {
        gradient.fill(0.0);
        let mut sum = 0.0;
        for i in 0..x.len() - 1 {
            let (valley, along) = (x[i + 1] - x[i] * x[i], 1.0 - x[i]);
            sum += 100.0 * valley * valley + along * along;
            gradient[i] += -400.0 * valley * x[i] - 2.0 * along;
            gradient[i + 1] += 200.0 * valley;
        }
        sum
    }

    fn minimum(iterations: usize) -> f64 {
        let step_lengths = &[0.01, 0.3, 0.7, 1.0];
        let settings = Settings { iterations, history: 15, step_lengths, longest_step: 0.5 };
        minimise(&settings, &mut [-1.2, 1.0], &mut rosenbrock)
    }

    #[test]
    fn the_valley_is_followed_to_its_end() {
        assert!(minimum(200) < 1e-10, "{}", minimum(200));
        // Negative control: there is a way to go.
        assert!(minimum(5) > 1e-2, "{}", minimum(5));
    }
}
