//! The twins against numbers from elsewhere (`expected-cuts.jsonl`) and against properties that need no numbers.

#[path = "reference/expected.rs"]
mod expected;
#[path = "reference/properties.rs"]
mod properties;
#[path = "reference/stages.rs"]
mod stages;
