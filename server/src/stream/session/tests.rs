//! The session against a scripted device: the test answers each job itself, so every order of events can be played.

mod camera;
mod edits;
mod faults;
mod groups;
mod questions;
mod random;
mod resolving;
mod scripted;
mod shared;
mod shared_budget;
mod steps;
mod surfaces;
mod time;
mod viewer;
