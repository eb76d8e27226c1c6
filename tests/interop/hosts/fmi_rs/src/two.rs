//! FMI 2.0.

use std::{error::Error, fs::File, path::PathBuf, sync::Arc};

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

use crate::{Job, TOLERANCE};

pub fn run(job: &Job) -> Result<(), Box<dyn Error>> {
    let builder = FMU2Builder::new(&PathBuf::from(&job.fmu))?;
    let description = Arc::new(builder.model_description);
    let outputs = (0..description.modelVariables.len())
        .filter(|&i| description.modelVariables[i].causality == Causality::Output)
        .collect();
    let settings = SimulationSettings {
        unzipdir: builder.unzipdir.path().to_path_buf(),
        model_description: description.clone(),
        start_time: 0.0,
        stop_time: job.stop,
        logging_on: false,
        set_stop_time: true,
        output_interval: job.step,
        log_time_scale: false,
        tolerance: TOLERANCE,
        set_tolerance: false,
        start_values: job.start.clone(),
        log_fmi_calls: false,
        input_file: None,
        early_return_allowed: false,
        event_mode_used: false,
        log_file: None,
        initial_fmu_state_file: None,
        final_fmu_state_file: None,
    };
    let rows = read_csv(File::open(&job.inputs)?, description.clone())?;
    let input = (!rows.is_empty()).then(|| Arc::new(StaticInput::new(rows, TOLERANCE)));
    let recorder = Arc::new(Recorder::new(Trajectories::new(description, outputs)));
    simulate(&settings, input, recorder.clone())?;
    write_csv(&recorder.trajectories.borrow(), &job.result)?;
    Ok(())
}
