//! Each request and each reply is the same after it was sent to another process.

mod errors;
mod values;

use std::collections::HashSet;
use std::mem::{Discriminant, discriminant};

use isopeel_kernels::{DeviceInfo, DeviceKind, Tuning};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::*;
use crate::{EngineId, WorkspaceMemory};

/// Returns a value as another process gets it.
fn sent<T: Serialize + DeserializeOwned>(value: &T) -> T {
    let bytes = postcard::to_stdvec(value).expect("serialized");
    let (value, rest) = postcard::take_from_bytes::<T>(&bytes).expect("deserialized");
    assert!(rest.is_empty(), "{} bytes were not read", rest.len());
    assert_eq!(postcard::to_stdvec(&value).expect("serialized again"), bytes);
    value
}

/// Reads all beginnings of a message, and the message with each of its bits flipped, which must not panic.
fn read_damaged<T: Serialize + DeserializeOwned>(value: &T) {
    let mut bytes = postcard::to_stdvec(value).expect("serialized");
    for end in 0..bytes.len() {
        assert!(postcard::from_bytes::<T>(&bytes[..end]).is_err(), "{end} bytes");
    }
    for bit in 0..8 * bytes.len() {
        bytes[bit / 8] ^= 1 << (bit % 8);
        // Some are other values of the type.
        drop(postcard::from_bytes::<T>(&bytes));
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
}

fn kinds<T>(values: &[T]) -> HashSet<Discriminant<T>> {
    values.iter().map(discriminant).collect()
}

macro_rules! same {
    ($before:expr, $after:expr, $kind:ident::$variant:ident: $($field:ident),*) => {{
        let $kind::$variant(after) = $after else { panic!("another variant") };
        $(assert_eq!($before.$field, after.$field, "{}", stringify!($variant.$field));)*
    }};
}

macro_rules! same_reply {
    ($before:expr, $after:expr, $variant:ident) => {{
        let DeviceReply::$variant(after) = $after else {
            panic!("another variant")
        };
        assert_eq!($before, after, stringify!($variant));
    }};
}

fn assert_same_volume(before: &VolumeStep, after: &VolumeStep) {
    assert_eq!(before.key(), after.key());
    let (before, after) = (before.dataset(), after.dataset());
    assert_eq!(before.geometry, after.geometry);
    assert_eq!(before.uneven, after.uneven);
    assert_eq!(before.axes, after.axes);
    assert_eq!(before.times, after.times);
    assert_eq!(before.opening, after.opening);
    assert_eq!(before.notice(), after.notice());
    assert_eq!((&before.title, before.layout), (&after.title, after.layout));
    for (before, after) in before.fields.iter().zip(&after.fields) {
        assert_eq!((&before.name, before.missing), (&after.name, after.missing));
        assert_eq!((before.all_labels(), &before.unit), (after.all_labels(), &after.unit));
    }
}

fn assert_same_request(before: &DeviceRequest, after: &DeviceRequest) {
    use DeviceRequest as R;
    match before {
        R::Resolve(r) => {
            same!(r, after, R::Resolve: view);
            let R::Resolve(after) = after else {
                panic!("another request")
            };
            assert_same_volume(&r.volume, &after.volume);
        }
        R::Prepare(r) => same!(r, after, R::Prepare: view),
        R::Count(r) => same!(r, after, R::Count: view),
        R::Refine(r) => same!(r, after, R::Refine: view, step, ceiling),
        R::Improve(r) => same!(r, after, R::Improve: view, ceiling),
        R::Measure(r) => same!(r, after, R::Measure: view),
        R::Extract(r) => same!(r, after, R::Extract: view, making),
        R::Ask(r) => {
            same!(r, after, R::Ask: question);
            let R::Ask(after) = after else {
                panic!("another request")
            };
            let shown = |ask: &Ask| ask.shown.as_ref().map(|shown| (shown.view.clone(), shown.cut));
            assert_eq!(shown(r), shown(after));
        }
        R::FindResident(r) => same!(r, after, R::FindResident: keys),
        R::UseField(r) => same!(r, after, R::UseField: key),
        R::Compute(r) => same!(r, after, R::Compute: key, user),
        R::BeginUpload(r) => same!(r, after, R::BeginUpload: key, grid, sample_type, missing, ahead_budget),
        R::ContinueUpload(r) => same!(r, after, R::ContinueUpload: key, samples),
        R::ContinueTable(r) => same!(r, after, R::ContinueTable: key),
        R::FinishUpload(r) => same!(r, after, R::FinishUpload: key, is_ahead),
        R::DropUpload(r) => same!(r, after, R::DropUpload: key),
        R::MakeSpaceAhead(r) => same!(r, after, R::MakeSpaceAhead: key, budget),
        R::MakeHostSpace(r) => same!(r, after, R::MakeHostSpace: bytes),
        R::Release(r) => same!(r, after, R::Release: step),
        R::UseHistogramFields(r) => same!(r, after, R::UseHistogramFields: key),
        R::ContinueHistogram(r) => same!(r, after, R::ContinueHistogram: key),
        R::ContinueOverview(r) => same!(r, after, R::ContinueOverview: key),
        R::ReadSamples(r) => same!(r, after, R::ReadSamples: key, planes),
        R::ReadSlice(r) => same!(r, after, R::ReadSlice: key, axis, index),
        R::CheckAnswers(_) => assert!(matches!(after, R::CheckAnswers(_))),
    }
}

fn assert_same_reply(before: &DeviceReply, after: &DeviceReply) {
    use DeviceReply as R;
    match before {
        R::Resolve(view) => same_reply!(view, after, Resolve),
        R::Prepare(view) => same_reply!(view, after, Prepare),
        R::Count(count) => same_reply!(count, after, Count),
        R::Refine(r) => {
            same!(r, after, R::Refine: view, cut, target, is_final, can_improve, wall, meshing);
            let R::Refine(after) = after else {
                panic!("another reply")
            };
            assert_eq!(r.surface.regions, after.surface.regions);
            assert_eq!(r.surface.remade, after.surface.remade);
            assert_eq!(r.surface.prefix, after.surface.prefix);
            assert_eq!(r.surface.statistics, after.surface.statistics);
        }
        R::Improve(r) => {
            let R::Improve(after) = after else {
                panic!("another reply")
            };
            assert_eq!(r.as_ref().map(|r| r.cut), after.as_ref().map(|r| r.cut));
        }
        R::Measure(measurement) => same_reply!(measurement, after, Measure),
        R::Extract(r) => {
            same!(r, after, R::Extract: view, wall, measured, refined);
            let R::Extract(after) = after else {
                panic!("another reply")
            };
            assert_eq!(r.surface.regions, after.surface.regions);
        }
        R::Ask(answer) => same_reply!(answer, after, Ask),
        R::FindResident(resident) => same_reply!(resident, after, FindResident),
        R::UseField(()) => assert!(matches!(after, R::UseField(()))),
        R::Compute(is_done) => same_reply!(is_done, after, Compute),
        R::BeginUpload(has_space) => same_reply!(has_space, after, BeginUpload),
        R::ContinueUpload(()) => assert!(matches!(after, R::ContinueUpload(()))),
        R::ContinueTable(is_done) => same_reply!(is_done, after, ContinueTable),
        R::FinishUpload(()) => assert!(matches!(after, R::FinishUpload(()))),
        R::DropUpload(()) => assert!(matches!(after, R::DropUpload(()))),
        R::MakeSpaceAhead(has_space) => same_reply!(has_space, after, MakeSpaceAhead),
        R::MakeHostSpace(()) => assert!(matches!(after, R::MakeHostSpace(()))),
        R::Release(()) => assert!(matches!(after, R::Release(()))),
        R::UseHistogramFields(()) => assert!(matches!(after, R::UseHistogramFields(()))),
        R::ContinueHistogram((_, histogram)) => {
            let R::ContinueHistogram((_, after)) = after else {
                panic!("another reply")
            };
            assert_eq!(histogram, after);
        }
        R::ContinueOverview(values) => {
            let R::ContinueOverview(after) = after else {
                panic!("another reply")
            };
            assert_eq!(format!("{values:?}"), format!("{after:?}"));
        }
        R::ReadSamples(samples) => same_reply!(samples, after, ReadSamples),
        R::ReadSlice(slice) => same_reply!(slice, after, ReadSlice),
        R::CheckAnswers(answers) => same_reply!(answers, after, CheckAnswers),
    }
}

#[test]
fn requests_are_the_same_in_another_process() {
    let requests = values::requests();
    assert_eq!(kinds(&requests).len(), NAMES.len(), "a request has no test: {NAMES:?}");
    for request in &requests {
        assert_same_request(request, &sent(request));
    }
}

#[test]
fn replies_are_the_same_in_another_process() {
    let replies = values::replies();
    assert_eq!(kinds(&replies).len(), NAMES.len(), "a reply has no test: {NAMES:?}");
    for reply in &replies {
        assert_same_reply(reply, &sent(reply));
    }
}

#[test]
fn damaged_messages_are_refused_or_other_messages() {
    values::requests().iter().for_each(read_damaged);
    values::replies().iter().for_each(read_damaged);
}

#[test]
fn a_device_is_the_same_in_another_process() {
    let device = DeviceInfo {
        index: 1,
        platform: "Portable Computing Language".into(),
        platform_version: "OpenCL 3.0 PoCL 6.0".into(),
        name: "cpu".into(),
        kind: DeviceKind::Cpu,
        memory_bytes: 1 << 40,
        max_allocation_bytes: 1 << 38,
        compute_units: 8,
        max_work_group: 4096,
        version: "OpenCL 3.0".into(),
        driver: "6.0".into(),
    };
    assert_eq!(sent(&device), device);
    assert_eq!(sent(&Tuning::GPU_SMALL), Tuning::GPU_SMALL);
    assert_eq!(sent(&EngineId::of_number(9)), EngineId::of_number(9));
    let memory = WorkspaceMemory {
        cuts: 5,
        ..WorkspaceMemory::default()
    };
    assert_eq!(sent(&memory).stated(DeviceKind::Gpu).cut_bytes, 5);
}

#[test]
fn the_bits_of_numbers_stay() {
    let bits = [0x7fc0_1234, 0xffff_ffff, 0x8000_0000, 0x7f80_0000, 0x0000_0001];
    let samples = Samples::F32(bits.map(f32::from_bits).to_vec());
    let Samples::F32(after) = sent(&samples) else {
        panic!("another type")
    };
    assert_eq!(after.iter().map(|x| x.to_bits()).collect::<Vec<_>>(), bits);
    for samples in [
        Samples::U8(vec![0, 255]),
        Samples::I8(vec![-128, 127]),
        Samples::U16(vec![0, 65535]),
        Samples::I16(vec![-32768, 32767]),
    ] {
        assert_eq!(sent(&samples), samples);
    }
}
