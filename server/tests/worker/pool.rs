//! A pool of devices of which one does not open.

use std::sync::mpsc;
use std::time::{Duration, Instant};

use isopeel::metrics::DeviceNumber;
use isopeel::service::{Choice, ChoiceError, DeviceOptions, DevicePool, DeviceWorker, Seat, StateReporter};
use isopeel_extraction::WorkError;
use isopeel_volumes::VolumeStep;

use crate::{ALONE, dataset};

/// Longest time that an answer may take that does not wait for a device.
const SOON: Duration = Duration::from_secs(3);

/// Starts a device that is opened once the returned sender sends; dropping the sender refuses the device.
fn device(index: usize) -> (DeviceWorker, mpsc::Sender<()>) {
    let (open, opened) = mpsc::channel();
    let choose = move |_: &StateReporter| match opened.recv() {
        Ok(()) => Ok(Choice::default()),
        Err(_) => Err(ChoiceError::Refused("it did not open".into())),
    };
    let options = DeviceOptions {
        number: DeviceNumber::new(index).expect("a number"),
        choose: Box::new(choose),
        ..DeviceOptions::unchecked(None)
    };
    (DeviceWorker::start_with(options).expect("a thread"), open)
}

/// Returns the number of the device on which the work is done, once it is open.
async fn device_of(pool: &DevicePool, seat: &Seat, volume: &VolumeStep) -> Result<usize, WorkError> {
    let work = |worker: DeviceWorker| async move { worker.ready().await.map(|_| worker.number().index()) };
    pool.perform(seat, volume, work).await
}

#[tokio::test(flavor = "multi_thread")]
async fn work_leaves_a_device_that_does_not_open_and_stays_where_it_went() {
    let _alone = ALONE.lock().await;
    let volume = VolumeStep::new(dataset(Vec::new()), 0).expect("a step");
    let ((first, open_first), (second, open_second)) = (device(0), device(1));
    let pool = DevicePool::new(vec![first, second.clone()]).expect("devices");
    let seat = Seat::default();
    // Neither is open: the first one gets the volume.
    let _ = pool.engine(&seat, &volume);
    assert_eq!([0, 1].map(|device| pool.assigned(&pool.members()[device])), [1, 0]);
    open_second.send(()).expect("the device waits");
    let start = Instant::now();
    assert_eq!(device_of(&pool, &seat, &volume).await.expect("a device"), 1);
    let waited = start.elapsed();
    assert!(
        waited >= Duration::from_secs(5),
        "a process may be replaced meanwhile: {waited:?}"
    );
    assert_eq!([0, 1].map(|device| pool.assigned(&pool.members()[device])), [0, 1]);
    let start = Instant::now();
    for seat in [&seat, &Seat::default()] {
        assert_eq!(device_of(&pool, seat, &volume).await.expect("a device"), 1);
        assert_eq!(pool.engine(seat, &volume), second.engine());
    }
    assert!(start.elapsed() < SOON, "{:?}", start.elapsed());
    // It is refused: the server goes on with the other one.
    drop(open_first);
    assert!(pool.members()[0].ready().await.is_err());
    assert_eq!(device_of(&pool, &seat, &volume).await.expect("a device"), 1);
    assert!(pool.answers_within(SOON).await);
    let ended = tokio::time::timeout(Duration::from_millis(200), pool.unusable()).await;
    assert!(ended.is_err(), "a device can be used");
}
