//! Free-space problems of a robot made of spheres, checked in lanes.

use rayon::prelude::*;

use super::rrt::{Connection, connect, numbers};
use super::simplify::simplify;
use super::{Domain, Edges, Found, NoPath, Settings, exact_ends, single};
use crate::kernels::obstacles::Obstacles;
use crate::kernels::validity::{Config, Scratch, Validity};

/// A robot among obstacles.
#[derive(Debug, Clone, Copy)]
pub struct RobotSpace<'a> {
    /// The robot's spheres.
    pub validity: &'a Validity,
    /// What they must stay clear of.
    pub obstacles: &'a Obstacles<'a>,
    /// Samples and metric.
    pub domain: &'a Domain,
    /// Budgets and densities.
    pub settings: &'a Settings,
}

/// A start, a goal and a seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Where to start (rad, m).
    pub start: Vec<f64>,
    /// Where to go (rad, m).
    pub goal: Vec<f64>,
    /// Seed of the random numbers.
    pub seed: u64,
}

struct InLanes<'a> {
    space: RobotSpace<'a>,
    resolution: f64,
    scratch: Scratch,
}

impl Edges for InLanes<'_> {
    fn is_free(&mut self, from: &Config, to: &Config) -> bool {
        let distance = f64::from(self.space.domain.distance(from, to));
        let count = (distance / self.resolution).ceil().max(1.0) as usize;
        let RobotSpace { validity, obstacles, .. } = self.space;
        validity.edge_is_free(from, to, count, obstacles, &mut self.scratch)
    }
}

impl<'a> RobotSpace<'a> {
    fn edges(&self, resolution: f64) -> InLanes<'a> {
        InLanes { space: *self, resolution, scratch: self.validity.scratch() }
    }

    /// True where one configuration is free.
    pub fn is_free(&self, q: &[f64]) -> bool {
        self.validity.is_free(&single(q), self.obstacles, &mut self.validity.scratch())
    }

    /// A simplified path, certified at a finer resolution than the search's.
    ///
    /// # Errors
    /// [`NoPath`]
    pub fn plan(&self, query: &Query) -> Result<Found, NoPath> {
        self.plan_observed(query, &mut || {})
    }

    /// As [`RobotSpace::plan`]; `connected` is called each time the search has a first path, before it is simplified, so
    /// that a benchmark can tell the two apart.
    ///
    /// # Errors
    /// [`NoPath`]
    pub fn plan_observed(
        &self,
        query: &Query,
        connected: &mut dyn FnMut(),
    ) -> Result<Found, NoPath> {
        let [start, goal] = [single(&query.start), single(&query.goal)];
        let settings = self.settings;
        let fine = settings.resolution / settings.certify.max(1) as f64;
        let mut edges = self.edges(settings.resolution);
        if !edges.is_free(&start, &start) {
            return Err(NoPath::Start);
        }
        if !edges.is_free(&goal, &goal) {
            return Err(NoPath::Goal);
        }
        for attempt in 0..settings.attempts.max(1) {
            let mut rng = numbers(query.seed, attempt);
            let simd = self.validity.simd();
            let found = connect(&mut edges, self.domain, settings, &start, &goal, &mut rng, simd);
            let Some(Connection { path, iterations, nodes }) = found else { continue };
            connected();
            let path = simplify(&mut edges, self.domain, settings, path, &mut rng);
            let mut finely = self.edges(fine);
            if path.windows(2).all(|w| finely.is_free(&w[0], &w[1])) {
                let path = exact_ends(&path, &query.start, &query.goal);
                return Ok(Found { path, iterations, nodes });
            }
            edges.resolution = fine;
        }
        Err(NoPath::Budget)
    }

    /// Many problems on all cores; results in their order, the same for any number of threads.
    pub fn plan_batch(&self, queries: &[Query]) -> Vec<Result<Found, NoPath>> {
        queries.par_iter().map(|query| self.plan(query)).collect()
    }
}
