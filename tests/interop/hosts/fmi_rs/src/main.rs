//! One FMU for co-simulation, run by fmi-rs:
//!
//!     hesr-fmi-rs FMI FMU INPUTS.csv RESULT.csv STOP STEP [NAME=VALUE...]
//!
//! FMI is the version, 2 or 3. The description is validated, the start values are set, and the inputs
//! of each row are set at its time. All outputs are written at every step.

mod three;
mod two;

use std::{env, error::Error, process::ExitCode};

const TOLERANCE: f64 = 1e-9; // relative, by which times count as the same

struct Job {
    fmu: String,
    inputs: String,
    result: String,
    stop: f64,
    step: f64,
    start: Vec<(String, String)>,
}

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
    let [fmi, fmu, inputs, result, stop, step, start @ ..] = arguments else {
        return Err("needed are FMI FMU INPUTS RESULT STOP STEP [NAME=VALUE...]".into());
    };
    let job = Job {
        fmu: fmu.clone(),
        inputs: inputs.clone(),
        result: result.clone(),
        stop: stop.parse()?,
        step: step.parse()?,
        start: start
            .iter()
            .filter_map(|pair| pair.split_once('='))
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect(),
    };
    match fmi.as_str() {
        "2" => two::run(&job),
        "3" => three::run(&job),
        _ => Err(format!("FMI is {fmi}; needed is 2 or 3").into()),
    }
}
