//! Refuses given settings that the training would not use.

use super::{DefaultsInput, Settings, SettingsSources, file};
use ashsplat::train::StrategyType::{Budget, Fixed, Mcmc, Reference};
use ashsplat::train::TrainSettings;
use ashsplat::{Error, Result};
use toml::Table;

/// Settings that only some trainings use. Those that the strategies refuse themselves are not listed.
struct Use {
    names: &'static [&'static str],
    is_used: fn(&Settings) -> bool,
    /// The option or kind of training that uses them.
    by: &'static str,
}

const fn used(names: &'static [&'static str], by: &'static str, is_used: fn(&Settings) -> bool) -> Use {
    Use { names, is_used, by }
}

const EXPOSURES: [&str; 6] = [
    "exposure_lr_init",
    "exposure_lr_final",
    "exposure_lr_delay_steps",
    "exposure_reg",
    "exposure_shared",
    "exposure_sparsity",
];

const USES: [Use; 14] = [
    used(&["cap_max"], "--strategy mcmc or budget", |s| matches!(s.train.strategy, Mcmc | Budget)),
    used(&["cap_ratio"], "--strategy budget without --cap-max", |s| {
        s.train.strategy != Budget || s.train.cap_max == 0
    }),
    used(&["noise_lr"], "--strategy mcmc", |s| s.train.strategy == Mcmc),
    used(&["percent_dense"], "--strategy reference", |s| s.train.strategy == Reference),
    used(
        &["densify_grad_threshold", "opacity_reset_interval", "min_opacity"],
        "--strategy reference or budget",
        |s| matches!(s.train.strategy, Reference | Budget),
    ),
    used(
        &["densify_from_iter", "densify_until_iter", "densification_interval"],
        "a strategy other than fixed",
        |s| s.train.strategy != Fixed,
    ),
    used(&["exposure_lr_delay_mult"], "--exposure with --exposure-lr-delay-steps", |s| {
        s.train.exposure && s.train.exposure_lr_delay_steps > 0
    }),
    used(&["initial_opacity", "initial_scale"], "a training from points, without --init", |s| {
        s.data.init.as_os_str().is_empty()
    }),
    used(&["antialiasing_detached"], "--antialiasing", |s| s.train.antialiasing),
    used(&["pose_lr"], "--pose-opt", |s| s.train.pose_opt),
    used(&["lens_opt_lr"], "--lens-opt", |s| s.train.lens_opt),
    used(&EXPOSURES, "--exposure", |s| s.train.exposure),
    used(&["lens_lr", "lens_reg"], "--lens-effects", |s| s.train.lens_effects),
    used(&["depth_l1_weight_init", "depth_l1_weight_final"], "depth maps (-d)", |s| {
        !s.data.depths.as_os_str().is_empty()
    }),
];

/// A given setting that the training does not use and whose value differs from the default, with the name of its user.
type Unused = (&'static str, &'static str);

fn unused(given: &Table, training: &Settings) -> Vec<Unused> {
    let of = |of: &'static Use| of.names.iter().map(move |&name| (name, of));
    let all = USES.iter().flat_map(of).filter(|(name, of)| {
        given.contains_key(*name) && !(of.is_used)(training) && training.differs_in(name)
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
fn refuse_no_growth(given: &Table, train: &TrainSettings) -> Result<()> {
    let names = ["densify_from_iter", "densify_until_iter"];
    let never = train.strategy != Fixed && train.densify_from_iter >= train.densify_until_iter;
    if !never || !names.iter().all(|name| given.contains_key(*name)) {
        return Ok(());
    }
    let problem = format!(
        "is {}, not below densify_until_iter ({}): nothing would ever grow; give others, or --strategy fixed",
        train.densify_from_iter, train.densify_until_iter
    );
    Err(Error::argument(names[0], problem))
}

impl SettingsSources {
    /// Refuses settings without effect, on the command line or in a file. A dump lists all settings, used or not, so it
    /// is not checked. The command line may switch off what another file switches on.
    pub fn refuse_unused(&self, settings: &Settings) -> Result<()> {
        refuse(unused(&self.from_args, settings).first(), &self.from_args)?;
        refuse_no_growth(&self.from_args, &settings.train)?;
        let Some(path) = &self.file else { return Ok(()) };
        if file::is_dump(path)? {
            return Ok(());
        }
        let given = &self.from_file;
        refuse_no_growth(given, &settings.train)?;
        let alone = Settings::from_table(given.clone(), &DefaultsInput::default())
            .map_err(|e| Error::argument("settings", e))?;
        let from_file = unused(given, &alone);
        let here = unused(given, settings);
        refuse(here.iter().find(|unused| from_file.contains(unused)), given)
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
