//! End-to-end tests, one binary: a server as `isopeel serve` runs it, and clients that know its documents but none of its
//! code. Without an OpenCL device they fail, unless `ISOPEEL_TESTS_WITHOUT_DEVICE=1` says that none is expected.

mod support;

mod abuse;
mod audit;
mod batch;
mod batch_requests;
mod bench;
mod budgets;
mod bytes;
mod cameras;
mod command_line;
mod crowd;
mod device_process;
mod documentation;
mod documented;
mod drivers;
mod edits;
mod expected_cuts;
mod exports;
mod faults;
mod interest;
mod interrupted;
mod jobs;
mod kills;
mod log;
mod memory;
mod metrics;
mod mutated;
mod overview;
mod parts;
mod questions;
mod rest;
mod shared;
mod slices;
mod slow_line;
mod startup;
mod states;
mod strangers;
mod stream;
mod surfaces;
mod tls;
mod tokens;
mod unix;
mod upgrade;
mod uploads;
