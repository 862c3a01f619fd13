//! Errors are the same in another process, as far as callers tell them apart.

use std::io;
use std::mem::discriminant;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use isopeel_kernels::Error;
use isopeel_kernels::check::CheckError;
use isopeel_view::EditError;
use isopeel_volumes::ReadError;

use super::{kinds, read_damaged, sent, values};
use crate::{JobError, OpenError, WorkError, chain};

/// Returns an error of each kind of the kernels.
fn kernel_errors() -> Vec<Error> {
    // The crate does not know the type of OpenCL's errors: the variant's number, the stage and the code.
    let launch = postcard::to_stdvec(&(4u8, "open", -9999i32)).expect("serialized");
    vec![
        Error::NoLoader,
        Error::NoDriver,
        Error::NoDevice {
            wanted: Some("gpu".into()),
            found: vec!["cpu".into()],
        },
        Error::Build {
            stage: "classify",
            options: "-I /opt/driver".into(),
            log: "/tmp/kernel.cl:1: error".into(),
        },
        postcard::from_bytes(&launch).expect("an error"),
        Error::OutOfDeviceMemory {
            stage: "minmax",
            needed_bytes: 1 << 40,
            limit_bytes: Some(7),
        },
        Error::Invalid {
            what: "level",
            why: "6".into(),
        },
        Error::Refused("it fails".into()),
        Error::ProgramUnchecked("cut".into()),
        Error::Cancelled,
    ]
}

/// Returns an error of each kind.
fn work_errors() -> Vec<WorkError> {
    let full = io::Error::new(io::ErrorKind::StorageFull, "no space");
    let path = Path::new("/data/7/scan.nrrd");
    let unreadable = ReadError::new(path, "data file", "\"/data/7/scan.raw\" has 3 bytes, expected 8");
    let wrong = OpenError::Check {
        device: "a GPU".into(),
        driver: "1.2".into(),
        why: Box::new(CheckError::Failed {
            stage: "cut",
            source: Error::Cancelled,
        }),
    };
    let (needed_bytes, limit_bytes) = (9, 8);
    let (limit, wait) = (Duration::from_millis(2500), Duration::from_secs(7));
    let mut errors = vec![
        WorkError::Busy,
        WorkError::Unreadable(unreadable),
        WorkError::Unreadable(ReadError::io(path, "data", "cannot be read", full)),
        WorkError::TooLarge {
            needed_bytes,
            limit_bytes,
        },
        WorkError::NotKept,
        WorkError::HostBusy { needed_bytes },
        WorkError::TooLargeForHost {
            needed_bytes,
            limit_bytes,
        },
        WorkError::TooLargeToShare { limit_bytes },
        WorkError::TooManyTriangles {
            triangles: 2,
            ceiling: 1,
        },
        WorkError::OverBudget { minimum: 3, budget: 2 },
        WorkError::OverBytes {
            minimum: 3,
            triangles: 7,
            budget: 2,
        },
        WorkError::NothingShown,
        WorkError::NoTree(Error::Refused("no".into())),
        WorkError::Edit(EditError {
            field: "iso",
            why: "NaN".into(),
        }),
        WorkError::TookTooLong { limit },
        WorkError::UserTime { limit, wait },
        WorkError::NoDevice(Arc::new(wrong)),
        WorkError::NoDevice(Arc::new(OpenError::Refused("unsafe".into()))),
        WorkError::DeviceLost,
        WorkError::EndsProcess { what: "2*ball".into() },
        WorkError::Reopening,
        WorkError::Cancelled,
        WorkError::Stopped,
    ];
    errors.extend(kernel_errors().into_iter().map(WorkError::Device));
    errors.extend(
        kernel_errors()
            .into_iter()
            .map(|error| WorkError::NoDevice(Arc::new(error.into()))),
    );
    errors
}

/// Returns the position of an error's kind among all kinds. Does not compile if a kind is missing.
fn position(error: &WorkError) -> usize {
    match error {
        WorkError::Busy => 0,
        WorkError::Unreadable(_) => 1,
        WorkError::TooLarge { .. } => 2,
        WorkError::NotKept => 3,
        WorkError::HostBusy { .. } => 4,
        WorkError::TooLargeForHost { .. } => 5,
        WorkError::TooManyTriangles { .. } => 6,
        WorkError::OverBudget { .. } => 7,
        WorkError::OverBytes { .. } => 8,
        WorkError::NothingShown => 9,
        WorkError::NoTree(_) => 10,
        WorkError::Edit(_) => 11,
        WorkError::TookTooLong { .. } => 12,
        WorkError::UserTime { .. } => 13,
        WorkError::Device(_) => 14,
        WorkError::NoDevice(_) => 15,
        WorkError::DeviceLost => 16,
        WorkError::Reopening => 17,
        WorkError::Cancelled => 18,
        WorkError::Stopped => 19,
        WorkError::EndsProcess { .. } => 20,
        WorkError::TooLargeToShare { .. } => 21,
    }
}

#[test]
fn errors_of_the_kernels_are_the_same_in_another_process() {
    let errors = kernel_errors();
    assert_eq!(kinds(&errors).len(), errors.len());
    for error in &errors {
        let after = sent(error);
        assert_eq!((error.to_string(), chain(error)), (after.to_string(), chain(&after)));
        assert_eq!(discriminant(error), discriminant(&after));
        assert_eq!(error.needs_new_process(), after.needs_new_process());
        assert_eq!(error.needs_new_process(), matches!(error, Error::Launch { .. }));
    }
}

#[test]
fn errors_of_work_are_the_same_in_another_process() {
    let errors = work_errors();
    let mut positions: Vec<_> = errors.iter().map(position).collect();
    positions.sort_unstable();
    positions.dedup();
    assert_eq!(positions, (0..22).collect::<Vec<_>>());
    for error in errors {
        let after = sent(&error);
        assert_eq!(discriminant(&error), discriminant(&after), "{error}");
        assert_eq!(error.to_string(), after.to_string());
        assert_eq!(error.code(), after.code(), "{error}");
        assert_eq!(error.public_message(), after.public_message());
        assert_eq!(error.rejects_view(), after.rejects_view(), "{error}");
        assert_eq!(error.suggested_triangles(), after.suggested_triangles(), "{error}");
        if let (WorkError::Unreadable(error), WorkError::Unreadable(after)) = (&error, &after) {
            assert_eq!(error.is_of_space(), after.is_of_space());
        }
        read_damaged(&error);
    }
}

#[test]
fn errors_of_jobs_are_the_same_in_another_process() {
    let errors = [
        JobError::NotResident {
            needed: vec![(values::key(), 7)],
            budget: u64::MAX,
        },
        JobError::NeedsHistograms(vec![values::histogram_key()]),
        JobError::TakesLong,
        JobError::NotBegun,
        JobError::Failed(WorkError::Busy),
    ];
    for error in errors {
        let after = sent(&error);
        // Does not compile if a kind is missing.
        match (&error, &after) {
            (JobError::NotResident { .. }, JobError::NotResident { .. })
            | (JobError::NeedsHistograms(_), JobError::NeedsHistograms(_))
            | (JobError::TakesLong, JobError::TakesLong)
            | (JobError::NotBegun, JobError::NotBegun)
            | (JobError::Failed(_), JobError::Failed(_)) => assert_eq!(format!("{error:?}"), format!("{after:?}")),
            (
                JobError::NotResident { .. }
                | JobError::NeedsHistograms(_)
                | JobError::TakesLong
                | JobError::NotBegun
                | JobError::Failed(_),
                _,
            ) => panic!("{error:?} became {after:?}"),
        }
        read_damaged(&error);
    }
}
