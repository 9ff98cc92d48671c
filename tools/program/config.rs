//! The settings of a training run: defaults, then `--config FILE`, then the command line; and their dumps.

mod block;
mod data;
mod few_photos;
mod file;
mod missing_points;
mod train_overrides;
mod unused;

pub use data::{AutoSwitch, DataSettings, Outside, Split};
pub use few_photos::DefaultsInput;

use crate::blocks::job::Job;
use crate::output;
use ashsplat::train::settings::TrainOption;
use ashsplat::train::{Preset, StrategyType, TrainSettings};
use ashsplat::{Error, Result};
use clap::error::ErrorKind;
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use toml::Table;

const PRESETS: [&str; 4] = ["fast", "default", "quality", "reference"];
/// Name of the settings dump for `--config`.
pub const SETTINGS_FILE: &str = "settings.toml";
/// Name of the settings dump in the reference's format.
pub const CFG_ARGS_FILE: &str = "cfg_args";
/// Name of the list of a run's cameras, held-out ones first.
pub const CAMERAS_FILE: &str = "cameras.json";

/// The settings that are given on the command line, by name. All are optional: what is not given comes from
/// `--config`, or else is the default.
#[derive(Default)]
pub struct Overrides(Table);

impl Args for Overrides {
    fn augment_args(command: Command) -> Command {
        let preset = Arg::new("preset").long("preset").value_name("NAME").value_parser(PRESETS);
        let preset = preset.help(
            "Settings for a purpose: fast (fewer Gaussians, small pictures first), default, quality (more Gaussians), reference \
             (the article's recipe). What is given otherwise wins [default: default; with --strategy: the strategy's own settings]",
        );
        DataSettings::augment_args_for_update(command).arg(preset).args(train_overrides::arguments())
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Overrides {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut overrides = Self::default();
        overrides.update_from_arg_matches(matches)?;
        Ok(overrides)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        let mut data = DataSettings::default();
        data.update_from_arg_matches(matches)?;
        let refused = |e: toml::ser::Error| clap::Error::raw(ErrorKind::ValueValidation, format!("{e}\n"));
        let data = Table::try_from(data).map_err(refused)?;
        self.0.extend(data.into_iter().filter(|(name, _)| matches.contains_id(name)));
        let preset = matches.get_one::<String>("preset");
        self.0.extend(preset.map(|name| ("preset".to_owned(), name.clone().into())));
        self.0.extend(train_overrides::given(matches));
        Ok(())
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    pub data: DataSettings,
    pub train: TrainSettings,
}

pub struct SettingsSources {
    file: Option<PathBuf>,
    from_file: Table,
    from_job: Table,
    from_args: Table,
}

impl SettingsSources {
    /// Reads the file, and the job that it or the command line names.
    pub fn read(file: Option<&Path>, overrides: &Overrides) -> Result<SettingsSources> {
        let from_file = file.map_or_else(|| Ok(Table::new()), file::table)?;
        let mut from_args = overrides.0.clone();
        // A preset is a set of defaults, which settings in the file would override.
        let chosen = set_by_presets().find(|&key| from_file.contains_key(key));
        if let (Some(path), Some(key), true) = (file, chosen, from_args.contains_key("preset")) {
            let problem = format!("sets {key}, which --preset would set");
            return Err(Error::input(path, problem, "leave out one of them, or --preset"));
        }
        // A job in a file counts only if the file lacks the settings that follow from it. A dump has all of them.
        let of_files = from_file.get("job").filter(|_| !from_file.contains_key("source_path"));
        let job = from_args.remove("job").or(of_files.cloned());
        let job = job.as_ref().and_then(toml::Value::as_str);
        let from_job = job.map_or_else(|| Ok(Table::new()), |job| Job::find(job)?.settings())?;
        Ok(SettingsSources { file: file.map(Path::to_owned), from_file, from_job, from_args })
    }

    /// Settles and checks all settings. Precedence: command line, job, file, defaults.
    pub fn settle(&self, input: &DefaultsInput) -> Result<Settings> {
        let sources = [&self.from_file, &self.from_job, &self.from_args].into_iter().flatten();
        let all = sources.map(|(key, value)| (key.clone(), value.clone())).collect();
        let mut settings =
            Settings::from_table(all, input).map_err(|problem| Error::argument("settings", problem))?;
        settings.train.check()?;
        settings.data.check_block()?;
        if settings.train.depth_points > 0.0 && !settings.data.depths.as_os_str().is_empty() {
            let problem = "does not go together with depth maps (-d): take one of them";
            return Err(Error::argument("depth_points", problem));
        }
        if settings.data.train_test_exp && !settings.data.eval {
            let problem = "is about held-out views: give --eval as well";
            return Err(Error::argument("train_test_exp", problem));
        }
        let train = &mut settings.train;
        train.sh_degree_start = train.sh_degree_start.max(input.sh_degree).min(train.sh_degree);
        Ok(settings)
    }

    fn has(&self, name: &str) -> bool {
        [&self.from_file, &self.from_job, &self.from_args].iter().any(|table| table.contains_key(name))
    }
}

/// Names of the settings in which a preset differs from its strategy, and `strategy` itself.
fn set_by_presets() -> impl Iterator<Item = &'static str> {
    let usual = TrainSettings::of_strategy(StrategyType::Budget);
    let presets = [Preset::Fast, Preset::Default, Preset::Quality].map(TrainSettings::of_preset);
    let differs = move |option: &&TrainOption| {
        presets.iter().any(|preset| (option.value)(preset) != (option.value)(&usual))
    };
    let names = TrainSettings::OPTIONS.iter().filter(differs).map(|option| option.name);
    std::iter::once("strategy").chain(names)
}

impl Settings {
    /// The settings of file and command line before data set and start are known.
    pub fn resolve(file: Option<&Path>, overrides: &Overrides) -> Result<Settings> {
        SettingsSources::read(file, overrides)?.settle(&DefaultsInput::default())
    }

    /// The settings that a run left in its folder: settings.toml, or the reference's `cfg_args`.
    pub fn of_model(folder: &Path) -> Result<Settings> {
        let settings_file = folder.join(SETTINGS_FILE);
        if settings_file.is_file() {
            return Settings::resolve(Some(&settings_file), &Overrides::default());
        }
        let reference = folder.join(CFG_ARGS_FILE);
        match reference.try_exists() {
            Ok(true) => Ok(Settings::from_cfg_args(&file::text(&reference)?)),
            Ok(false) => Ok(Settings::reference()),
            Err(e) => Err(Error::io(reference, "read", e)),
        }
    }

    /// The settings of the reference implementation, for scenes that do not say how they were trained.
    pub fn reference() -> Settings {
        let data = DataSettings { eval_split: Split::Reference, ..DataSettings::default() };
        Settings { data, train: TrainSettings::reference() }
    }

    fn from_table(mut table: Table, input: &DefaultsInput) -> Result<Settings, String> {
        let message = |e: toml::de::Error| e.message().to_owned();
        let preset = table.remove("preset").map(Preset::deserialize).transpose().map_err(message)?;
        let data_keys = Table::try_from(DataSettings::default()).map_err(|e| e.to_string())?;
        let (data, train): (Table, Table) =
            table.into_iter().partition(|(key, _)| data_keys.contains_key(key));
        let strategy = train.get("strategy").cloned().map(StrategyType::deserialize).transpose();
        let strategy = strategy.map_err(message)?;
        let usual = input.defaults(preset, strategy);
        if preset.is_some() && strategy.is_some_and(|strategy| strategy != usual.strategy) {
            return Err(
                "the strategy differs from the preset's: leave out the preset, or the strategy".into()
            );
        }
        let splits = data.contains_key("eval_split");
        let mut data: DataSettings = data.try_into().map_err(message)?;
        if (usual.strategy == StrategyType::Reference || data.train_test_exp) && !splits {
            data.eval_split = Split::Reference;
        }
        if data.train_test_exp && train.get("exposure").and_then(toml::Value::as_bool) == Some(false) {
            return Err("train_test_exp measures under exposures: leave out that, or exposure = false".into());
        }
        let mut all = Table::try_from(usual).map_err(|e| e.to_string())?;
        all.extend(train);
        if data.train_test_exp {
            all.insert("exposure".into(), true.into());
        }
        Ok(Settings { data, train: all.try_into().map_err(message)? })
    }

    pub fn to_toml(&self) -> Result<String> {
        let problem = |e: toml::ser::Error| Error::argument("settings", e.to_string());
        let data = toml::to_string(&self.data).map_err(problem)?;
        let train = toml::to_string(&self.train).map_err(problem)?;
        Ok(format!("{}{data}{train}", file::dump_line()))
    }

    /// The line that the reference writes: the `repr` of its parsed model arguments, which viewers and scripts
    /// read.
    pub fn to_cfg_args(&self) -> String {
        let python = |value: bool| if value { "True" } else { "False" };
        let quoted = |path: &Path| python_string(&output::absolute(path).to_string_lossy());
        format!(
            "Namespace(sh_degree={}, source_path={}, model_path={}, images={}, depths={}, resolution={}, \
             white_background={}, train_test_exp={}, data_device='cuda', eval={})",
            self.train.sh_degree,
            quoted(&self.data.source_path),
            python_string(&self.data.model_path.to_string_lossy()),
            python_string(&self.data.images),
            python_string(&self.data.depths.to_string_lossy()),
            self.data.resolution,
            python(self.train.white_background),
            python(self.data.train_test_exp),
            python(self.data.eval),
        )
    }

    fn from_cfg_args(text: &str) -> Settings {
        let mut settings = Settings::reference();
        let text_of = |key| file::cfg_value(text, key).map(|v| v.trim_matches(['\'', '"']).to_owned());
        let flag_of = |key| file::cfg_value(text, key) == Some("True");
        if let Some(source) = text_of("source_path") {
            settings.data.source_path = source.into();
        }
        if let Some(images) = text_of("images") {
            settings.data.images = images;
        }
        if let Some(resolution) = file::cfg_value(text, "resolution").and_then(|v| v.parse().ok()) {
            settings.data.resolution = resolution;
        }
        settings.data.eval = flag_of("eval");
        settings.data.train_test_exp = flag_of("train_test_exp");
        settings.train.exposure = settings.data.train_test_exp;
        settings.train.white_background = flag_of("white_background");
        settings.train.antialiasing = flag_of("antialiasing");
        settings
    }
}

fn python_string(text: &str) -> String {
    format!("'{}'", text.replace('\\', "\\\\").replace('\'', "\\'"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::train::settings::OptionKind;
    use toml::Value;

    pub(super) fn given(text: &str) -> Overrides {
        Overrides(text.parse().expect("TOML"))
    }

    #[test]
    fn a_preset_sets_defaults_and_no_more() {
        let resolved = |given: &str| {
            let overrides: Table = given.parse().expect("TOML");
            Settings::from_table(overrides, &DefaultsInput::default())
        };
        for (name, preset) in
            PRESETS.into_iter().zip([Preset::Fast, Preset::Default, Preset::Quality, Preset::Reference])
        {
            let settings = resolved(&format!("preset = '{name}'")).expect("settings");
            assert_eq!(settings.train, TrainSettings::of_preset(preset));
            // The dump has all settings, and no preset.
            let dump = settings.to_toml().expect("a dump");
            assert_eq!(resolved(&dump).expect("settings"), settings);
        }
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.toml");
        std::fs::write(&file, "iterations = 900\n").expect("written");
        let fast = given("preset = 'fast'");
        let both = Settings::resolve(Some(&file), &fast).expect("settings").train;
        assert_eq!(both, TrainSettings { iterations: 900, ..TrainSettings::of_preset(Preset::Fast) });
        std::fs::write(&file, "strategy = 'budget'\n").expect("written");
        let refused = Settings::resolve(Some(&file), &fast).expect_err("the file has chosen").to_string();
        assert!(refused.contains("a.toml: sets strategy"), "{refused}");
        let refused = resolved("train_test_exp = true\nexposure = false").expect_err("contradictory");
        assert!(refused.contains("exposure = false"), "{refused}");
        let both = resolved("preset = 'fast'\nstrategy = 'budget'\ncap_ratio = 3.0").expect("settings").train;
        assert_eq!(both, TrainSettings { cap_ratio: 3.0, ..TrainSettings::of_preset(Preset::Fast) });
        let refused = resolved("preset = 'fast'\nstrategy = 'mcmc'").expect_err("contradictory");
        assert!(refused.contains("leave out the preset"), "{refused}");
        assert!(resolved("preset = 'good'").expect_err("unknown").contains("good"));
        assert!(
            [Preset::Fast, Preset::Default, Preset::Quality, Preset::Reference]
                .into_iter()
                .all(|preset| TrainSettings::of_preset(preset).check().is_ok())
        );
    }

    /// Options, files and checkpoints share names and types of values.
    #[test]
    fn every_option_is_on_the_command_line_and_in_the_file() {
        let file = Table::try_from(TrainSettings::reference()).expect("a table");
        let options = TrainSettings::OPTIONS;
        assert_eq!(file.len(), options.len());
        let command = Command::new("train").args(train_overrides::arguments());
        for option in options {
            let argument = command.get_arguments().find(|argument| argument.get_id() == option.name);
            let argument = argument.expect("an argument");
            assert_eq!(argument.get_long(), Some(option.name.replace('_', "-").as_str()));
            let given = match (&file[option.name], option.kind) {
                (Value::Integer(_), OptionKind::Integer) => "7",
                (Value::Float(_), OptionKind::Number) => "0.5",
                (Value::Boolean(_), OptionKind::Switch) => "true",
                (Value::String(name), OptionKind::Choice(names)) => {
                    assert_eq!(Some(&name.as_str()), names.first(), "the default comes first");
                    names[1]
                }
                (value, kind) => panic!("{}: {value} is no {kind:?}", option.name),
            };
            let arguments = ["train".to_owned(), format!("--{}={given}", option.name.replace('_', "-"))];
            let matches = command.clone().try_get_matches_from(arguments).expect("accepted");
            let mut table = train_overrides::given(&matches);
            table.entry("strategy").or_insert("reference".into());
            let settings = Settings::from_table(table, &DefaultsInput::default()).expect("settings").train;
            assert_eq!((option.value)(&settings).to_string(), given, "{}", option.name);
            let changed = settings.values().into_iter().zip(TrainSettings::reference().values());
            assert_eq!(changed.filter(|(a, b)| a != b).count(), 1, "{}", option.name);
        }
    }

    #[test]
    fn cfg_args_of_the_reference() {
        let mut settings = Settings::reference();
        settings.data.source_path = "/data/it's".into();
        settings.data.eval = true;
        let line = settings.to_cfg_args();
        // On Windows with the drive.
        let path = std::path::absolute("/data/it's").expect("a path").display().to_string();
        let path = path.replace('\\', r"\\").replace('\'', r"\'");
        assert!(line.starts_with(&format!("Namespace(sh_degree=3, source_path='{path}', ")), "{line}");
        let read = Settings::from_cfg_args(
            "Namespace(data_device='cuda', eval=True, images='images_4', resolution=2, source_path='/data/truck', white_background=True)",
        );
        assert_eq!(read.data.source_path, PathBuf::from("/data/truck"));
        assert_eq!((read.data.images.as_str(), read.data.resolution, read.data.eval), ("images_4", 2, true));
        assert!(read.train.white_background);
    }
}
