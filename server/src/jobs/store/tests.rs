use isopeel_extraction::MeasuredError;

use super::super::error::JobError;
use super::super::results::Written;
use super::super::testing::{LIMITS, job, open, open_new};
use super::super::{Limits, MAX_ATTEMPTS, MAX_JOBS, MAX_UNFINISHED_JOBS, OPERATOR};
use super::work::Outcome;
use super::*;
use crate::jobs::ExtractionState;

fn done(bytes: u64) -> Outcome {
    Outcome::Done {
        written: Written {
            bytes,
            checksum: [3; 32],
        },
        triangles: 7,
        error: Some(MeasuredError { rms: 0.25, max: 0.5 }),
        notices: vec!["rounded".into()],
        seconds: 2.0,
    }
}

fn cause() -> Cause {
    Cause {
        code: "device".into(),
        detail: "lost".into(),
    }
}

#[tokio::test]
async fn a_job_goes_from_queued_to_done_and_its_events_say_how() {
    let (_folder, store, _) = open_new().await;
    let (queued, is_new) = store.submit(job("x", None, 2), LIMITS).await.unwrap();
    assert!(is_new);
    assert_eq!((queued.state, queued.extractions.total), (JobState::Queued, 2));
    for extraction in 0..2 {
        let work = store.begin_attempt().await.unwrap().unwrap();
        assert_eq!(
            (work.extraction, work.request.edit.iso),
            (extraction, Some(extraction as f32))
        );
        assert_eq!(work.bytes_taken, 100 * u64::from(extraction));
        let running = store.get(OPERATOR, "x").await.unwrap();
        let eta = if extraction == 0 { 10.0 } else { 2.0 };
        assert_eq!((running.state, running.eta_seconds), (JobState::Running, Some(eta)));
        assert!(store.finish(&work, done(100)).await.unwrap());
    }
    assert_eq!(store.begin_attempt().await.unwrap(), None);
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!((info.state, info.bytes, info.eta_seconds), (JobState::Done, 200, None));
    assert!(
        info.finished >= info.started && info.started >= Some(info.submitted),
        "{info:?}"
    );

    let (events, is_finished) = store.events(OPERATOR, "x", 0).await.unwrap();
    assert!(is_finished);
    let told: Vec<_> = events
        .iter()
        .map(|event| (event.state, event.extraction, event.extractions.done))
        .collect();
    let expected = [
        (JobState::Queued, None, 0),
        (JobState::Running, None, 0),
        (JobState::Running, Some(0), 1),
        (JobState::Done, Some(1), 2),
    ];
    assert_eq!(told, expected);
    assert!(events.is_sorted_by(|a, b| a.id < b.id), "{events:?}");
    let (rest, _) = store.events(OPERATOR, "x", events[1].id.unwrap()).await.unwrap();
    assert_eq!(rest, events[2..]);

    let result = store.result(OPERATOR, "x", 1).await.unwrap();
    assert_eq!((result.bytes, result.checksum), (100, [3; 32]));
    assert_eq!(
        store.results().await.unwrap(),
        HashSet::from([("x".into(), 0), ("x".into(), 1)])
    );
}

#[tokio::test]
async fn owners_take_turns_and_each_ones_jobs_come_in_their_order() {
    let (_folder, store, _) = open_new().await;
    let of = |owner: &str, id: &str, extractions| {
        let mut job = job(id, None, extractions);
        job.request.owner = owner.into();
        job
    };
    for (owner, id, extractions) in [("b", "b1", 3), ("b", "b2", 2), ("c", "c1", 1), ("a", "a1", 2)] {
        store.submit(of(owner, id, extractions), LIMITS).await.unwrap();
    }
    let mut order = Vec::new();
    while let Some(work) = store.begin_attempt().await.unwrap() {
        order.push(format!("{} {}", work.job, work.extraction));
        if order.len() == 1 {
            // Three owners: each has one turn in three.
            let eta = store.get("a", "a1").await.unwrap().eta_seconds;
            assert_eq!(eta, Some(3.0 * 10.0));
        }
        store.finish(&work, done(1)).await.unwrap();
        // An owner who comes later waits for at most one turn of each other owner.
        if order.len() == 4 {
            store.submit(of("bb", "bb1", 1), LIMITS).await.unwrap();
        }
    }
    let expected = ["a1 0", "b1 0", "c1 0", "a1 1", "b1 1", "bb1 0", "b1 2", "b2 0", "b2 1"];
    assert_eq!(order, expected);
}

#[tokio::test]
async fn attempts_are_counted_before_they_start_and_end_after_three() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = open(folder.path()).await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    drop(store);
    // A process that ends in each attempt.
    for _ in 0..MAX_ATTEMPTS {
        let (store, _) = open(folder.path()).await;
        assert_eq!(store.begin_attempt().await.unwrap().unwrap().extraction, 0);
    }
    let (store, _) = open(folder.path()).await;
    let work = store.begin_attempt().await.unwrap().unwrap();
    assert_eq!(work.extraction, 1, "the other is made still");
    assert!(store.finish(&work, done(1)).await.unwrap());
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!(
        (info.state, info.extractions.done, info.extractions.failed),
        (JobState::Failed, 1, 1)
    );
    assert_eq!(info.error.unwrap().detail, "1 of 2 extractions have no result");
    assert_eq!(info.failures[0].cause.code, "attempts-exhausted");
    let missing = store.result(OPERATOR, "x", 0).await.unwrap_err().to_string();
    assert_eq!(
        missing,
        "extraction 0 of job x failed: the server ended during each of 3 attempts"
    );
}

#[tokio::test]
async fn an_attempt_that_is_given_back_does_not_count_and_one_that_failed_does() {
    let (_folder, store, _) = open_new().await;
    store.submit(job("x", None, 1), LIMITS).await.unwrap();
    for _ in 0..2 * MAX_ATTEMPTS {
        let work = store.begin_attempt().await.unwrap().unwrap();
        assert!(store.finish(&work, Outcome::GivenBack).await.unwrap());
    }
    for _ in 0..MAX_ATTEMPTS {
        assert_eq!(store.get(OPERATOR, "x").await.unwrap().extractions.failed, 0);
        let work = store.begin_attempt().await.unwrap().unwrap();
        assert!(store.finish(&work, Outcome::Failed(cause())).await.unwrap());
    }
    assert_eq!(store.begin_attempt().await.unwrap(), None);
    assert_eq!(store.get(OPERATOR, "x").await.unwrap().failures[0].cause, cause());
}

#[tokio::test]
async fn what_no_attempt_would_change_fails_at_once() {
    let (_folder, store, _) = open_new().await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    store.submit(job("y", None, 1), LIMITS).await.unwrap();
    let work = store.begin_attempt().await.unwrap().unwrap();
    assert!(store.finish(&work, Outcome::Refused(cause())).await.unwrap());
    let work = store.begin_attempt().await.unwrap().unwrap();
    assert_eq!((work.job.as_str(), work.extraction), ("x", 1));
    assert!(store.finish(&work, Outcome::JobFailed(cause())).await.unwrap());
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!((info.state, info.error), (JobState::Failed, Some(cause())));
    assert_eq!(store.begin_attempt().await.unwrap().unwrap().job, "y");
}

fn empty() -> Outcome {
    Outcome::Empty(Cause {
        code: "empty-surface".into(),
        detail: "no surface at isovalue 1".into(),
    })
}

#[tokio::test]
async fn an_empty_surface_is_noted_and_the_others_go_on() {
    let (_folder, store, _) = open_new().await;
    store.submit(job("x", None, 3), LIMITS).await.unwrap();
    for outcome in [done(100), empty()] {
        let work = store.begin_attempt().await.unwrap().unwrap();
        assert!(store.finish(&work, outcome).await.unwrap());
    }
    let states = async || {
        let entries = store.manifest(OPERATOR, "x").await.unwrap();
        entries.into_iter().map(|entry| entry.state).collect::<Vec<_>>()
    };
    use ExtractionState::{Done, Empty, Waiting};
    assert_eq!(states().await, [Done, Empty, Waiting]);
    let work = store.begin_attempt().await.unwrap().unwrap();
    assert!(store.finish(&work, empty()).await.unwrap());
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!((info.state, info.error), (JobState::Done, None));
    assert_eq!((info.extractions.done, info.extractions.empty), (1, 2));

    let entries = store.manifest(OPERATOR, "x").await.unwrap();
    let first = serde_json::json!({
        "extraction": 0, "state": "done", "file": "00000.stl", "triangles": 7, "error": {"rms": 0.25, "max": 0.5},
        "bytes": 100, "sha256": "03".repeat(32), "seconds": 2.0, "notices": ["rounded"],
    });
    assert_eq!(serde_json::to_value(&entries[0]).unwrap(), first);
    let second = serde_json::json!({
        "extraction": 1, "state": "empty",
        "problem": {"code": "empty-surface", "detail": "no surface at isovalue 1"},
    });
    assert_eq!(serde_json::to_value(&entries[1]).unwrap(), second);
    let missing = store.result(OPERATOR, "x", 1).await.unwrap_err().to_string();
    assert_eq!(missing, "extraction 1 of job x is empty: no surface at isovalue 1");
}

#[tokio::test]
async fn a_job_of_empty_surfaces_alone_has_failed() {
    let (_folder, store, _) = open_new().await;
    for (id, outcomes, code) in [
        ("x", [empty(), empty()], "empty-surface"),
        ("y", [empty(), Outcome::Refused(cause())], "extractions-failed"),
    ] {
        store.submit(job(id, None, 2), LIMITS).await.unwrap();
        for outcome in outcomes {
            let work = store.begin_attempt().await.unwrap().unwrap();
            assert!(store.finish(&work, outcome).await.unwrap());
        }
        let info = store.get(OPERATOR, id).await.unwrap();
        assert_eq!(
            (info.state, info.error.unwrap().code.as_str()),
            (JobState::Failed, code)
        );
    }
}

#[tokio::test]
async fn a_store_of_the_first_version_is_brought_up_to_date() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    let old = Connection::open(&file).unwrap();
    old.execute_batch(MIGRATIONS[0]).unwrap();
    old.execute_batch(
        "INSERT INTO jobs (id, owner, digest, volume, input, state, submitted, total, done, estimated_triangles,
            estimated_bytes, estimated_seconds) VALUES ('x', 'operator', x'00', 'a', '{}', 'running', 1, 2, 1, 1, 1, 1);
        INSERT INTO extractions (job, extraction, request, state) VALUES (1, 0, '{\"step\":0,\"format\":\"stl\"}', 'done');
        INSERT INTO events (job, event) VALUES
            (1, '{\"state\":\"running\",\"extractions\":{\"total\":2,\"done\":1,\"failed\":0}}');",
    )
    .unwrap();
    old.pragma_update(None, "user_version", 1).unwrap();
    drop(old);
    let store = Store::open(&file).unwrap();
    let info = store.get(OPERATOR, "x").await.unwrap();
    assert_eq!((info.extractions.done, info.extractions.empty), (1, 0));
    assert_eq!(store.events(OPERATOR, "x", 0).await.unwrap().0.len(), 1);
    assert_eq!(
        store.manifest(OPERATOR, "x").await.unwrap()[0].file.as_deref(),
        Some("00000.stl")
    );
}

#[tokio::test]
async fn a_key_stands_for_one_request() {
    let (_folder, store, _) = open_new().await;
    let (first, _) = store.submit(job("x", Some("k"), 2), LIMITS).await.unwrap();
    let (again, is_new) = store.submit(job("y", Some("k"), 2), LIMITS).await.unwrap();
    assert_eq!((again.id.as_str(), is_new), (first.id.as_str(), false));
    let other = store.submit(job("z", Some("k"), 3), LIMITS).await.unwrap_err();
    assert!(
        matches!(&other, JobError::KeyReused { job, .. } if job == "x"),
        "{other}"
    );
    let mut of_another = job("z", Some("k"), 3);
    of_another.request.owner = "another".into();
    assert!(
        store.submit(of_another, LIMITS).await.unwrap().1,
        "keys are an owner's own"
    );
    store.submit(job("w", None, 2), LIMITS).await.unwrap();
    assert!(
        store.submit(job("v", None, 2), LIMITS).await.unwrap().1,
        "without a key each is new"
    );
}

#[tokio::test]
async fn nobody_sees_jobs_of_another_owner() {
    let (_folder, store, _) = open_new().await;
    store.submit(job("x", None, 1), LIMITS).await.unwrap();
    let work = store.begin_attempt().await.unwrap().unwrap();
    store.finish(&work, done(1)).await.unwrap();
    assert_eq!(store.list("another").await.unwrap(), []);
    let unknown = |error: JobError| assert!(matches!(&error, JobError::UnknownJob(id) if id == "x"), "{error}");
    unknown(store.get("another", "x").await.unwrap_err());
    unknown(store.cancel("another", "x").await.unwrap_err());
    unknown(store.delete("another", "x").await.unwrap_err());
    unknown(store.events("another", "x", 0).await.unwrap_err());
    unknown(store.result("another", "x", 0).await.unwrap_err());
    assert_eq!(store.list(OPERATOR).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_cancelled_job_takes_no_result_and_a_finished_one_can_be_deleted() {
    let (_folder, store, _) = open_new().await;
    store.submit(job("x", None, 2), LIMITS).await.unwrap();
    let work = store.begin_attempt().await.unwrap().unwrap();
    let refused = store.delete(OPERATOR, "x").await.unwrap_err();
    assert!(matches!(&refused, JobError::NotFinished(_)), "{refused}");
    assert_eq!(store.cancel(OPERATOR, "x").await.unwrap().state, JobState::Cancelled);
    assert!(!store.finish(&work, done(1)).await.unwrap());
    assert_eq!(store.begin_attempt().await.unwrap(), None);
    let again = store.cancel(OPERATOR, "x").await.unwrap_err().to_string();
    assert_eq!(again, "job x is cancelled, expected one that is queued or running");
    let (before, _) = store.events(OPERATOR, "x", 0).await.unwrap();
    store.delete(OPERATOR, "x").await.unwrap();
    assert!(!store.finish(&work, done(1)).await.unwrap());
    assert!(store.list(OPERATOR).await.unwrap().is_empty());
    // Ids of events are not used again.
    store.submit(job("y", None, 1), LIMITS).await.unwrap();
    let (after, _) = store.events(OPERATOR, "y", 0).await.unwrap();
    assert!(after[0].id > before.last().unwrap().id);
}

#[tokio::test]
async fn what_is_above_a_limit_is_refused_with_numbers() {
    let (_folder, store, _) = open_new().await;
    let limits = Limits { quota_bytes: 2_500 };
    store.submit(job("a", None, 1), limits).await.unwrap();
    let work = store.begin_attempt().await.unwrap().unwrap();
    store.finish(&work, done(700)).await.unwrap();
    store.submit(job("b", None, 1), limits).await.unwrap();
    // 700 bytes that were made, and 1,000 that are estimated.
    let refused = store.submit(job("c", None, 1), limits).await.unwrap_err();
    assert!(
        matches!(
            refused,
            JobError::OverQuota {
                estimated: 1_000,
                left: 800,
                quota: 2_500
            }
        ),
        "{refused}"
    );
    for n in 1..MAX_UNFINISHED_JOBS {
        store.submit(job(&format!("d{n}"), None, 1), LIMITS).await.unwrap();
    }
    let refused = store.submit(job("e", None, 1), LIMITS).await.unwrap_err().to_string();
    assert_eq!(
        refused,
        "there are 100 jobs that are not finished, the limit is 100: wait for one, or cancel it"
    );
    for n in 0.. {
        store
            .write(|transaction| Ok::<_, StoreError>(transaction.execute_batch("UPDATE jobs SET state = 'done'")?))
            .await
            .unwrap();
        let many = (0..MAX_UNFINISHED_JOBS).map(|i| job(&format!("f{n}-{i}"), None, 1));
        for next in many {
            if let Err(refused) = store.submit(next, LIMITS).await {
                let expected = "there are 1000 jobs, the limit is 1000: delete some that are finished";
                assert_eq!(refused.to_string(), expected);
                assert_eq!(store.list(OPERATOR).await.unwrap().len() as u64, MAX_JOBS);
                return;
            }
        }
    }
}

#[tokio::test]
async fn a_store_of_a_newer_program_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jobs.sqlite");
    drop(Store::open(&file).unwrap());
    Connection::open(&file)
        .unwrap()
        .pragma_update(None, "user_version", 9)
        .unwrap();
    let error = Store::open(&file).unwrap_err().to_string();
    assert_eq!(
        error,
        "the job store has version 9, this program knows those up to 2: start a newer one, or name another state folder"
    );
}

#[tokio::test]
async fn writes_are_on_the_disk_when_they_return() {
    let (folder, store, _) = open_new().await;
    let pragma = |name: &'static str| {
        store.write(move |transaction| {
            let value = transaction.pragma_query_value(None, name, |row| row.get::<_, rusqlite::types::Value>(0));
            Ok::<_, StoreError>(value?)
        })
    };
    assert_eq!(
        pragma("synchronous").await.unwrap(),
        rusqlite::types::Value::Integer(2),
        "FULL"
    );
    assert_eq!(
        pragma("journal_mode").await.unwrap(),
        rusqlite::types::Value::Text("wal".into())
    );
    assert_eq!(
        pragma("foreign_keys").await.unwrap(),
        rusqlite::types::Value::Integer(1)
    );
    drop(folder);
}

#[tokio::test]
async fn what_frees_space_is_written_on_a_full_disk() {
    let (folder, store, _) = open_new().await;
    let reserve = folder.path().join("jobs.reserve");
    assert_eq!(std::fs::metadata(&reserve).unwrap().len(), RESERVE_BYTES as u64);
    let taken = reserve.clone();
    // As a disk that is full as long as the reserve is on it.
    let work = move |_: &Transaction<'_>| {
        let full = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_FULL);
        let full = StoreError::from(rusqlite::Error::SqliteFailure(full, None));
        if taken.exists() { Err(full.into()) } else { Ok(7) }
    };
    assert_eq!(store.write_from_reserve(work).await.unwrap(), 7);
    assert!(reserve.exists(), "it is made again");
    store.submit(job("x", None, 1), LIMITS).await.unwrap();
    store.cancel(OPERATOR, "x").await.unwrap();
    store.delete(OPERATOR, "x").await.unwrap();
}
