//! The promises that solaspect keeps, one file for each, linked as one program.

mod common;

mod accuracy;
mod allocations;
mod archive;
mod calibrate_camera;
mod calibrate_mounting;
mod calibrate_plate;
mod calibrate_roll_camera;
mod camera;
mod cli;
mod command_line;
#[cfg(feature = "console")]
mod console;
mod coordinates;
mod disc_search;
mod disks;
mod fits;
mod flight;
mod foreign_frames;
mod fuzz_seeds;
#[cfg(feature = "gige")]
mod gige;
mod gondola_path;
mod horizon;
mod horizon_sensitivity;
mod hostile_files;
mod identification;
mod imports;
mod limb;
mod link;
mod link_cli;
mod link_service;
mod marks;
mod moon;
mod moon_in_flight;
mod navigation;
mod navigation_in_flight;
mod photon_transfer;
mod pointing;
mod power_cut;
mod preflight;
mod refine;
mod refine_inputs;
mod refine_navigation;
mod refine_roll;
mod refined_flights;
mod roll_in_flight;
mod scale;
mod service;
mod simulated_flight;
mod simulation;
mod sky;
mod solution_log;
mod swinging_path;
mod tracking;
