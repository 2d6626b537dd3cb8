//! What a check finds.

use akrobat_model::Rejection;

/// A reason to refuse a trajectory and the sentence that explains it.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// The reason.
    pub rejection: Rejection,
    /// Which sample, which joint or link pair, how much.
    pub detail: String,
}

impl Finding {
    /// A finding.
    pub fn new(rejection: Rejection, detail: impl Into<String>) -> Self {
        Self { rejection, detail: detail.into() }
    }
}

/// The largest of many values and what it was found at.
#[derive(Debug, Clone, Copy)]
pub struct Worst<T> {
    /// The largest value; 0 before any was seen.
    pub value: f64,
    /// Where.
    pub at: Option<T>,
}

impl<T> Default for Worst<T> {
    fn default() -> Self {
        Self { value: 0.0, at: None }
    }
}

impl<T> Worst<T> {
    /// Takes note of a value.
    pub fn see(&mut self, value: f64, at: T) {
        if value > self.value {
            *self = Self { value, at: Some(at) };
        }
    }

    /// Where the value is above `limit`, the place it was found at.
    pub fn above(self, limit: f64) -> Option<T> {
        if self.value > limit { self.at } else { None }
    }
}
