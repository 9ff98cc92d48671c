//! Refuses given settings that the training would not use.

use super::{Facts, Given, Settings, TrainOverrides, file};
use ashsplat::train::{StrategyType, TrainSettings};
use ashsplat::{Error, Result};
use toml::Table;

/// Settings that only some trainings use. Those that the strategies refuse themselves are not listed.
struct Use {
    names: &'static [&'static str],
    is_used: fn(&Settings) -> bool,
    /// Name of what uses them.
    by: &'static str,
}

const USES: [Use; 13] = [
    Use {
        names: &["cap_max"],
        is_used: |s| matches!(s.train.strategy, StrategyType::Mcmc | StrategyType::Budget),
        by: "--strategy mcmc or budget",
    },
    Use {
        names: &["cap_ratio"],
        is_used: |s| s.train.strategy != StrategyType::Budget || s.train.cap_max == 0,
        by: "--strategy budget without --cap-max",
    },
    Use { names: &["noise_lr"], is_used: |s| s.train.strategy == StrategyType::Mcmc, by: "--strategy mcmc" },
    Use {
        names: &["percent_dense"],
        is_used: |s| s.train.strategy == StrategyType::Reference,
        by: "--strategy reference",
    },
    Use {
        names: &["densify_grad_threshold", "opacity_reset_interval", "min_opacity"],
        is_used: |s| matches!(s.train.strategy, StrategyType::Reference | StrategyType::Budget),
        by: "--strategy reference or budget",
    },
    Use {
        names: &["densify_from_iter", "densify_until_iter", "densification_interval"],
        is_used: |s| s.train.strategy != StrategyType::Fixed,
        by: "a strategy other than fixed",
    },
    Use {
        names: &["exposure_lr_delay_mult"],
        is_used: |s| s.train.exposure && s.train.exposure_lr_delay_steps > 0,
        by: "--exposure with --exposure-lr-delay-steps",
    },
    Use {
        names: &["initial_opacity", "initial_scale"],
        is_used: |s| s.data.init.as_os_str().is_empty(),
        by: "a training from points, without --init",
    },
    Use { names: &["antialiasing_detached"], is_used: |s| s.train.antialiasing, by: "--antialiasing" },
    Use { names: &["pose_lr"], is_used: |s| s.train.pose_opt, by: "--pose-opt" },
    Use {
        names: &[
            "exposure_lr_init",
            "exposure_lr_final",
            "exposure_lr_delay_steps",
            "exposure_reg",
            "exposure_shared",
            "exposure_sparsity",
        ],
        is_used: |s| s.train.exposure,
        by: "--exposure",
    },
    Use { names: &["lens_lr", "lens_reg"], is_used: |s| s.train.lens_effects, by: "--lens-effects" },
    Use {
        names: &["depth_l1_weight_init", "depth_l1_weight_final"],
        is_used: |s| !s.data.depths.as_os_str().is_empty(),
        by: "depth maps (-d)",
    },
];

/// A given setting that none of the trainings uses, and whose value differs from the default in some of them; and its
/// user.
type Unused = (&'static str, &'static str);

/// All unused settings.
fn unused(given: &Table, trainings: &[Settings]) -> Vec<Unused> {
    let of = |of: &'static Use| of.names.iter().map(move |&name| (name, of));
    let all = USES.iter().flat_map(of).filter(|(name, of)| {
        given.contains_key(*name)
            && !trainings.iter().any(of.is_used)
            && trainings.iter().any(|training| training.differs_in(name))
    });
    all.map(|(name, of)| (name, of.by)).collect()
}

fn refuse(first: Option<&Unused>, given: &Table) -> Result<()> {
    let Some((name, by)) = first else { return Ok(()) };
    let value = given.get(*name).map(toml::Value::to_string).unwrap_or_default();
    let problem = format!("is {value}, which has no effect here: it is for {by}; leave it out, or train so");
    Err(Error::argument(*name, problem))
}

/// Refuses growth that ends before it begins, if both ends are given. One alone switches growth off, as in the
/// reference.
fn refuse_no_growth(given: &Table, trainings: &[Settings]) -> Result<()> {
    let names = ["densify_from_iter", "densify_until_iter"];
    let never = |s: &&Settings| {
        s.train.strategy != StrategyType::Fixed && s.train.densify_from_iter >= s.train.densify_until_iter
    };
    let is_given = names.iter().all(|name| given.contains_key(*name));
    let Some(Settings { train, .. }) = trainings.iter().find(never).filter(|_| is_given) else {
        return Ok(());
    };
    let problem = format!(
        "is {}, not below densify_until_iter ({}): nothing would ever grow; give others, or --strategy fixed",
        train.densify_from_iter, train.densify_until_iter
    );
    Err(Error::argument(names[0], problem))
}

/// Refuses given settings that none of the trainings would use.
fn check(given: &Table, trainings: &[Settings]) -> Result<()> {
    refuse(unused(given, trainings).first(), given)?;
    refuse_no_growth(given, trainings)
}

impl TrainOverrides {
    /// Refuses settings that none of the trainings would use.
    pub fn refuse_unused(&self, trainings: &[Settings]) -> Result<()> {
        check(&self.0, trainings)
    }
}

impl Given {
    /// Refuses settings without effect, on the command line or in a file. A dump lists all settings, used or not, so it
    /// is not checked. The command line may switch off what another file switches on.
    pub fn refuse_unused(&self, settings: &Settings) -> Result<()> {
        let training = std::slice::from_ref(settings);
        check(&self.of_line, training)?;
        let Some(path) = &self.file else { return Ok(()) };
        if file::is_dump(path)? {
            return Ok(());
        }
        let given = &self.of_file;
        refuse_no_growth(given, training)?;
        let alone = Settings::from_table(given.clone(), &Facts::default())
            .map_err(|e| Error::argument("settings", e))?;
        let of_file = unused(given, &[alone]);
        let here = unused(given, training);
        refuse(here.iter().find(|unused| of_file.contains(unused)), given)
    }
}

impl Settings {
    /// True if a setting differs from the default of its strategy.
    fn differs_in(&self, name: &str) -> bool {
        let usual = TrainSettings::of_strategy(self.train.strategy);
        let option = TrainSettings::OPTIONS.iter().find(|option| option.name == name);
        option.is_some_and(|option| (option.value)(&self.train) != (option.value)(&usual))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_that_of_a_setting() {
        for name in USES.iter().flat_map(|of| of.names) {
            assert!(TrainSettings::OPTIONS.iter().any(|option| option.name == *name), "{name}");
        }
    }

    #[test]
    fn what_has_no_effect_is_named_with_what_would_use_it() {
        let refused = |given: &str| {
            let given: Table = given.parse().expect("TOML");
            let settings = Settings::from_table(given.clone(), &Facts::default()).expect("settings");
            TrainOverrides(given).refuse_unused(&[settings]).err().map(|error| error.to_string())
        };
        for (given, by) in [
            ("strategy = 'fixed'\ndensify_until_iter = 9", "other than fixed"),
            ("strategy = 'fixed'\nmin_opacity = 0.1", "reference or budget"),
            ("strategy = 'mcmc'\nmin_opacity = 0.1", "reference or budget"),
            ("init = 'a.ply'\ninitial_scale = 0.5", "from points"),
            ("strategy = 'mcmc'\ninit = 'a.ply'\ninitial_opacity = 0.1", "from points"),
            ("exposure = true\nexposure_lr_delay_mult = 0.5", "--exposure-lr-delay-steps"),
            (
                "strategy = 'budget'\ndensify_from_iter = 200\ndensify_until_iter = 100",
                "nothing would ever grow",
            ),
        ] {
            assert!(refused(given).is_some_and(|message| message.contains(by)), "{given}");
        }
        for given in [
            "strategy = 'fixed'\nmin_opacity = 0.005",
            "densify_until_iter = 9",
            "densify_from_iter = 5\ndensify_until_iter = 9",
            "strategy = 'mcmc'\ninit = 'a.ply'",
            "initial_scale = 0.5",
            "exposure = true\nexposure_lr_delay_steps = 9\nexposure_lr_delay_mult = 0.5",
        ] {
            assert_eq!(refused(given), None, "{given}");
        }
    }
}
