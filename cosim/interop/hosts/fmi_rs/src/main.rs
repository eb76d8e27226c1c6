//! One FMU for co-simulation, run by fmi-rs:
//!
//!     hesr-fmi-rs FMU INPUTS.csv RESULT.csv STOP STEP [NAME=VALUE...]
//!
//! The description is validated, the start values are set, and the inputs of each row are set at its
//! time. All outputs are written at every step.

use std::{env, error::Error, fs::File, path::PathBuf, process::ExitCode, sync::Arc};

use fmi_rs::{
    fmi2::builder::FMU2Builder,
    model_description::fmi2::Causality,
    sim::fmi2::{
        SimulationSettings, Trajectories,
        cs::simulate,
        csv::{read_csv, write_csv},
        input::StaticInput,
        recorder::Recorder,
    },
};

const TOLERANCE: f64 = 1e-9; // relative, by which times count as the same

fn main() -> ExitCode {
    match run(&env::args().skip(1).collect::<Vec<_>>()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<(), Box<dyn Error>> {
    if arguments == ["--version"] {
        println!("fmi-rs {}", env!("CARGO_PKG_VERSION"));
        return Ok(());
    }
    let [fmu, inputs, result, stop, step, start @ ..] = arguments else {
        return Err("needed are FMU INPUTS RESULT STOP STEP [NAME=VALUE...]".into());
    };
    let builder = FMU2Builder::new(&PathBuf::from(fmu))?;
    let description = Arc::new(builder.model_description);
    let outputs = (0..description.modelVariables.len())
        .filter(|&i| description.modelVariables[i].causality == Causality::Output)
        .collect();
    let settings = SimulationSettings {
        unzipdir: builder.unzipdir.path().to_path_buf(),
        model_description: description.clone(),
        start_time: 0.0,
        stop_time: stop.parse()?,
        logging_on: false,
        set_stop_time: true,
        output_interval: step.parse()?,
        log_time_scale: false,
        tolerance: TOLERANCE,
        set_tolerance: false,
        start_values: start
            .iter()
            .filter_map(|pair| pair.split_once('='))
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect(),
        log_fmi_calls: false,
        input_file: None,
        early_return_allowed: false,
        event_mode_used: false,
        log_file: None,
        initial_fmu_state_file: None,
        final_fmu_state_file: None,
    };
    let rows = read_csv(File::open(inputs)?, description.clone())?;
    let input = (!rows.is_empty()).then(|| Arc::new(StaticInput::new(rows, TOLERANCE)));
    let recorder = Arc::new(Recorder::new(Trajectories::new(description, outputs)));
    simulate(&settings, input, recorder.clone())?;
    write_csv(&recorder.trajectories.borrow(), result)?;
    Ok(())
}
