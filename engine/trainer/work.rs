//! Work that a strategy requests from training, and its reports.

/// Work between two steps: a set of up to 32 actions. The strategy interprets them. The two named actions also tell the program
/// whether the scene is complete, so a strategy must use them in their sense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Actions(pub u32);

impl Actions {
    /// Empty set.
    pub const NONE: Self = Self(0);
    /// A densification.
    pub const DENSIFY: Self = Self(1);
    /// An opacity reset.
    pub const RESET_OPACITY: Self = Self(2);

    /// Returns the union of both sets.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the set if the condition holds, otherwise the empty set.
    #[must_use]
    pub const fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Returns the set without the actions of another set.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// True if all actions of another set are in this one.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// True if the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the action with the lowest bit, which comes first.
    #[must_use]
    pub const fn first(self) -> Self {
        Self(self.0 & self.0.wrapping_neg())
    }
}

/// Part of an iteration's work that the strategy decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// True if the backward pass adds to the gradient statistics
    /// ([`StepInputs::statistics`](super::strategy::StepInputs::statistics)).
    pub accumulates: bool,
    /// True if the optimiser makes a step.
    pub optimizes: bool,
    /// True if this iteration's gradients add to those since the last step, and a step of this iteration takes the sum. A
    /// change of the set of Gaussians drops the sum. See [`Hooks::sums`](super::strategy::Hooks::sums).
    pub sums_gradients: bool,
    /// True if that step moves the opacities.
    pub optimizes_opacity: bool,
    /// Work before the next iteration.
    pub actions: Actions,
}

/// Outcome of [`Strategy::between_steps`](super::Strategy::between_steps).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Change of the set of Gaussians, if any.
    pub densified: Option<Densified>,
    /// True if opacities were reset.
    pub opacities_reset: bool,
}

/// Report of a densification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Number of Gaussians before.
    pub before: u32,
    /// Number of Gaussians that stayed.
    pub kept: u32,
    /// Number of added clones.
    pub cloned: u32,
    /// Number of Gaussians that were replaced by two each.
    pub split: u32,
    /// True if memory or the device's limits were too small. Then only the Gaussians with the largest gradients were cloned or
    /// split, or none were pruned.
    pub limited: bool,
}

impl Densified {
    /// Number of Gaussians afterwards.
    pub fn rows(&self) -> u32 {
        self.kept + self.cloned + 2 * self.split
    }
}

/// A buffer of a strategy with values per Gaussian: zero at the start and after each change of the set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statistic {
    /// Name in memory reports and in the checkpoint.
    pub name: &'static str,
    /// Number of floats per Gaussian.
    pub floats: u32,
}

/// Norm of the 2D mean's gradient (NDC) summed over views, and the number of views. The backward pass accumulates it if
/// [`Work::accumulates`] is set. The first of every trainer's statistics.
pub const GRADIENT_STATISTIC: Statistic = Statistic { name: "statistics", floats: 2 };

/// Norm of the absolute gradients of the 2D mean (NDC), summed over the same views: ‖(W/2 Σ|g_x|, H/2 Σ|g_y|)‖. Here g is the
/// gradient with respect to the 2D mean in pixels through one pixel alone (AbsGS, Ye et al. 2024). A strategy that lists it in
/// [`Strategy::statistics`](super::Strategy::statistics) need not record it: the backward pass accumulates it beside
/// [`GRADIENT_STATISTIC`].
pub const ABSOLUTE_STATISTIC: Statistic = Statistic { name: "absolute_statistics", floats: 1 };

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_done_one_by_one_densification_first() {
        let mut due = Actions::DENSIFY.and(Actions::RESET_OPACITY).and(Actions(1 << 31));
        let mut order = Vec::new();
        while !due.is_empty() {
            order.push(due.first());
            due = due.without(due.first());
        }
        assert_eq!(order, [Actions::DENSIFY, Actions::RESET_OPACITY, Actions(1 << 31)]);
        assert_eq!(Actions::DENSIFY.when(false), Actions::NONE);
        assert!(!Actions::DENSIFY.contains(Actions::RESET_OPACITY));
    }
}
