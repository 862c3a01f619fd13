//! Sums over the tasks of a measurement.

use crate::layout::{ErrorSum, ErrorTask};
use crate::surface::SurfaceError;

/// Weighted sums over distances of one kind.
#[derive(Clone, Copy, Default)]
pub struct Distances {
    sum2: f64,
    weight: f64,
    max: f32,
}

impl Distances {
    fn add(&mut self, more: &ErrorSum) {
        self.sum2 += f64::from(more.sum2);
        self.weight += f64::from(more.weight);
        self.max = self.max.max(more.max);
    }

    fn mean2(&self) -> f64 {
        if self.weight > 0.0 {
            self.sum2 / self.weight
        } else {
            0.0
        }
    }
}

/// Combines the distances in both directions: the mean of the two mean squares, and the greater maximum.
pub fn both(crossings: &Distances, samples: &Distances) -> SurfaceError {
    SurfaceError {
        rms: ((crossings.mean2() + samples.mean2()) / 2.0).sqrt() as f32,
        max: crossings.max.max(samples.max),
    }
}

/// Of each active region, and of the whole surface.
#[derive(Default)]
pub struct Sums {
    pub regions: Vec<Distances>,
    pub whole: Distances,
}

impl Sums {
    pub fn new(regions: usize) -> Self {
        Self {
            regions: vec![Distances::default(); regions],
            ..Self::default()
        }
    }

    pub fn add(&mut self, tasks: &[ErrorTask], sums: &[ErrorSum]) {
        for (task, sum) in tasks.iter().zip(sums) {
            self.regions[task.region as usize].add(sum);
            self.whole.add(sum);
        }
    }
}
