//! Tests of the crate's internals that need a device: how its compiler treats shared structs and indices past 2³², and the memory
//! that meshes are read into.

use crate::check::{self, Check};
use crate::context::read_back::Blocks;
use crate::expression::{Binary, Op};
use crate::lock::lock;
use crate::testing::{compiled_soon, device};
use crate::{DeviceKind, Engine, Error, Expression, Grid, Never, SampleType, Samples, Tuning, layout, stages};

#[test]
fn device_and_host_lay_structs_out_alike() {
    let Some(engine) = device() else { return };
    let args = stages::declarations().into_iter().map(|d| (d.name, d.fields, d.layout));
    let structs: Vec<_> = layout::structs().into_iter().chain(args).collect();
    let (mut body, mut count) = (String::new(), 0);
    for (name, fields, _) in &structs {
        body += &format!("out[{count}] = (uint)sizeof({name});\n");
        for (at, field) in (count + 1..).zip(fields) {
            body += &format!("out[{at}] = (uint)((size_t)&((__global {name} *)0)->{field});\n");
        }
        count += 1 + fields.len();
    }
    let probe = format!("#include \"lib/args.h\"\n__kernel void layout_probe(__global uint *out) {{\n{body}}}\n");
    let kernels = engine.cx.build(&probe, "-cl-std=CL1.2").expect("the probe builds");
    let out = engine.cx.filled("test", count, u32::MAX).expect("a buffer");
    engine
        .cx
        .launch("test", kernels.get("layout_probe"), 1, 1, &[&out])
        .expect("the probe runs");
    let mut numbers = engine.cx.read("test", &out, count).expect("numbers").into_iter();
    for (name, _, want) in structs {
        let got: Vec<usize> = numbers.by_ref().take(want.len()).map(|n| n as usize).collect();
        assert_eq!(got, want, "size and field offsets of {name}");
    }
}

#[test]
#[should_panic(expected = "arguments of a kernel of stage test")]
fn a_short_list_of_arguments_is_not_launched() {
    let Some(engine) = device() else {
        panic!("without a device: arguments of a kernel of stage test")
    };
    let probe = "__kernel void two(const uint n, __global uint *out) { out[0] = n; }";
    let kernels = engine.cx.build(probe, "-cl-std=CL1.2").expect("the probe builds");
    let out = engine.cx.filled("test", 1, 0).expect("a buffer");
    let _ = engine.cx.launch("test", kernels.get("two"), 1, 1, &[&out]);
}

#[test]
fn indices_pass_32_bits() {
    let Some(engine) = device() else { return };
    // samples[4 i]: a sample and the first plane of its slab.
    let probe = "
__kernel void index_probe(const Grid grid, __global const uint *samples, __global uint *out, __global uint *regions) {
    const uint i = (uint)get_global_id(0);
    const int3 p = (int3)((int)samples[4 * i], (int)samples[4 * i + 1], (int)samples[4 * i + 2]);
    const ulong index = sample_index(grid, samples[4 * i + 3], p);
    out[2 * i] = (uint)index;
    out[2 * i + 1] = (uint)(index >> 32);
    const uint3 cell = convert_uint3(p);
    const uint region = ((cell.z >> 5) * grid.regions[1] + (cell.y >> 5)) * grid.regions[0] + (cell.x >> 5);
    const uint3 origin = region_origin(grid, region);
    const uint3 within = unmorton(morton(cell & 31u));
    regions[4 * i] = region;
    regions[4 * i + 1] = origin.x + within.x;
    regions[4 * i + 2] = origin.y + within.y;
    regions[4 * i + 3] = origin.z + within.z;
}
";
    let kernels = engine
        .cx
        .build(
            &format!("#include \"lib/grid.h\"\n#include \"lib/morton.h\"\n#include \"lib/samples.h\"\n{probe}"),
            "-cl-std=CL1.2 -DSAMPLE=uchar",
        )
        .expect("the probe builds");
    for dims in [[2048, 2048, 2048], [65_536, 65_537, 3], [2, 70_000, 70_000]] {
        let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
        let regions = grid.regions();
        let on_device = layout::Grid {
            dims,
            regions,
            spacing: [1.0; 3],
            missing: f32::NAN,
        };
        let mixed = |i: u64| i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        let mut samples: Vec<[u32; 4]> = (0..62)
            .map(|i: u64| {
                let p: [u32; 3] =
                    std::array::from_fn(|axis| (mixed(4 * i + axis as u64) % u64::from(dims[axis])) as u32);
                [p[0], p[1], p[2], (mixed(4 * i + 3) % (u64::from(p[2]) + 1)) as u32]
            })
            .collect();
        samples.push([0; 4]);
        samples.push([dims[0] - 1, dims[1] - 1, dims[2] - 1, 0]);
        let input = engine.cx.upload("test", &samples).expect("samples");
        let out = engine.cx.buffer::<[u32; 2]>("test", 64).expect("a buffer");
        let found = engine.cx.buffer::<[u32; 4]>("test", 64).expect("a buffer");
        engine
            .cx
            .launch(
                "test",
                kernels.get("index_probe"),
                1,
                64,
                &[&on_device, &input, &out, &found],
            )
            .expect("the probe runs");
        let out = engine.cx.read("test", &out, 64).expect("indices");
        let found = engine.cx.read("test", &found, 64).expect("regions");
        for ((&[x, y, z, z0], [low, high]), [region, at @ ..]) in samples.iter().zip(out).zip(found) {
            let [nx, ny, _] = dims.map(u64::from);
            let want = (u64::from(z - z0) * ny + u64::from(y)) * nx + u64::from(x);
            assert_eq!(
                u64::from(low) | u64::from(high) << 32,
                want,
                "sample {x} {y} {z} of {dims:?} from plane {z0}"
            );
            let linear = (z / 32 * regions[1] + y / 32) * regions[0] + x / 32;
            // The last samples along an axis may have no cell of their own, and so no region.
            if (0..3).all(|i| [x, y, z][i] / 32 < regions[i]) {
                assert_eq!(
                    (region, at),
                    (linear, [x, y, z]),
                    "region and position of cell {x} {y} {z} of {dims:?}"
                );
            }
        }
        assert!(u64::from(on_device.dims[0]) * u64::from(dims[1]) * u64::from(dims[2]) > u64::from(u32::MAX));
    }
}

/// Parts that fill several blocks, one larger than a block, empty ones and gaps between them: also while all blocks are held.
#[test]
fn parts_are_read_as_they_are() {
    let Some(engine) = device() else { return };
    let cx = &engine.cx;
    let data: Vec<u32> = (0..5 << 20).map(|i: u32| i.wrapping_mul(2_654_435_761)).collect();
    let large = (1 << 20) + 100;
    let mut parts = vec![0..1, 1..1, 7..large];
    let mut at = large;
    while at + 200_003 < data.len() {
        parts.push(at..at + 200_000);
        at += 200_003;
    }
    let read = || {
        let buffer = cx.upload("test", &data).unwrap();
        let read = cx.read_to_blocks("test", &buffer, &parts).unwrap();
        assert_eq!(read.len(), parts.len());
        for (read, part) in read.iter().zip(&parts) {
            assert!(read[..] == data[part.clone()], "{part:?}");
        }
        assert!(cx.read_to_blocks("test", &buffer, &[]).unwrap().is_empty());
        let read_otherwise = cx.read_parts("test", buffer, &parts).unwrap();
        assert!(read_otherwise == read);
        read
    };
    let allocated = || lock(&cx.blocks).allocated;
    drop(read());
    let first = allocated();
    drop(read());
    assert_eq!(allocated(), first, "blocks that came back are not used again");
    let held: Vec<_> = (0..16).map(|_| read()).collect();
    assert_eq!(allocated(), Blocks::MAX_BLOCKS, "in use by {} surfaces", held.len());
}

/// If the device is the host's processor, a mesh is not copied: its memory is lent to the host, and reused once dropped.
#[test]
fn lent_memory_is_used_again_when_it_is_dropped() {
    let Some(engine) = device() else { return };
    let cx = &engine.cx;
    let data: Vec<u32> = (0..1000).collect();
    let lend = || {
        let buffer = cx.upload("test", &data).unwrap();
        (
            buffer.handle(),
            cx.read_parts("test", buffer, &[1..4, 900..1000]).unwrap(),
        )
    };
    let (first, mut parts) = lend();
    let last = parts.pop();
    drop(parts);
    let (second, _) = lend();
    assert_eq!(last.as_deref(), Some(&data[900..]));
    if cx.found.info.kind != crate::DeviceKind::Cpu {
        return;
    }
    assert_ne!(first, second, "overwritten while it is lent");
    drop(last);
    let (third, fourth) = (lend(), lend());
    assert!([third.0, fourth.0].contains(&first), "lost");
}

#[test]
fn a_field_that_comes_in_pieces_is_the_same() {
    // With one device there is one of these at a time, cut into slabs that share planes.
    if device().is_none() {
        return;
    }
    let limit = 37 * 29 * 70 * size_of::<f32>() as u64;
    let engine = Engine::open_limited(None, Some(limit)).expect("a device");
    let grid = Grid::new([37, 29, 150], [1.0; 3]).expect("a grid");
    let values: Vec<i16> = (0..grid.sample_count()).map(|i| (i * 7919 % 4001) as i16).collect();
    let whole = engine
        .upload(grid, &Samples::I16(values.clone()), None)
        .expect("a volume");
    assert!(whole.slabs.len() > 1);
    let mut upload = engine
        .begin_upload(&grid.into(), SampleType::I16, None)
        .expect("memory");
    for piece in values.chunks(10_007) {
        let piece = Samples::I16(piece.to_vec());
        engine.continue_upload(&mut upload, &piece).expect("on the device");
    }
    let more = engine.continue_upload(&mut upload, &Samples::I16(vec![0]));
    assert!(more.is_err(), "more than the grid has");
    let joined = engine.finish_upload(upload).expect("a volume");
    let (a, b) = (engine.download(&whole, 0..150), engine.download(&joined, 0..150));
    assert_eq!(a.expect("samples"), Samples::I16(values));
    assert_eq!(b.expect("samples"), engine.download(&whole, 0..150).expect("samples"));
    let table = |volume: &crate::Volume| {
        engine
            .cx
            .read("test", &volume.table, volume.table.len())
            .expect("a table")
    };
    // By bits: bricks without cells have no numbers.
    let bits = |table: Vec<[f32; 2]>| {
        table
            .into_iter()
            .map(|range| range.map(f32::to_bits))
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(table(&joined)), bits(table(&whole)));
    for (slab, other) in whole.slabs.iter().zip(&joined.slabs) {
        let bytes = |slab: &crate::volume::Slab| engine.cx.read("test", &slab.samples, slab.samples.len());
        assert_eq!(bytes(slab).expect("samples"), bytes(other).expect("samples"));
    }

    let mut short = engine
        .begin_upload(&grid.into(), SampleType::I16, None)
        .expect("memory");
    engine
        .continue_upload(&mut short, &Samples::I16(vec![0; 5]))
        .expect("on the device");
    assert!(
        engine.continue_upload(&mut short, &Samples::U8(vec![0; 5])).is_err(),
        "another type"
    );
    assert!(engine.finish_upload(short).is_err(), "fewer than the grid has");
}

fn check_all(engine: &Engine, sample_type: SampleType) {
    let mut check = Check::new(engine, sample_type);
    for step in check::STEPS {
        if let Err(error) = check.run(step) {
            panic!("{error}: {:?}", std::error::Error::source(&error));
        }
    }
}

#[test]
fn the_check_finds_nothing_on_a_device_that_is_right() {
    let Some(engine) = device() else { return };
    check_all(&engine, SampleType::I8);
    check_all(&engine, SampleType::F32);
}

/// The workaround for drivers that compile the kernels of their kind of device wrongly.
#[test]
fn the_check_finds_nothing_with_kernels_of_the_other_kind_or_small_groups() {
    let Some(engine) = device() else { return };
    let name = engine.device().name.clone();
    for tuning in [Tuning::GPU, Tuning::GPU_SMALL] {
        let tuning = compiled_soon(tuning, engine.device());
        let engine = Engine::open_tuned(Some(&name), None, Some(tuning)).expect("a device");
        check_all(&engine, SampleType::U8);
    }
}

/// The server relies on this when a driver loses the device: `answers` notices the loss, and if only a new process can open the device
/// again, the error says so.
#[test]
#[ignore = "a CPU's driver would end the process: on a GPU, cargo test -p isopeel-kernels -- --ignored lost"]
fn a_gpu_that_is_lost_is_noticed() {
    let Some(engine) = device() else { return };
    assert!(engine.answers());
    let probe = "__kernel void fault(__global uint *out, const uint far) { out[(ulong)far << 12] = 1; }";
    let kernels = engine.cx.build(probe, "-cl-std=CL1.2").expect("the probe builds");
    let out = engine.cx.filled("test", 1, 0).expect("a buffer");
    let launched = engine.cx.launch("test", kernels.get("fault"), 1, 1, &[&out, &u32::MAX]);
    let seen = launched.and_then(|()| engine.cx.finish("test"));
    println!("the driver says {seen:?}");
    assert!(seen.is_err() && !engine.answers(), "the device is lost");
    drop((out, kernels, engine));
    match Engine::open(None) {
        Ok(again) => check_all(&again, SampleType::F32),
        Err(error) => assert!(error.needs_new_process(), "{error:?}"),
    }
}

/// Compiling the interpreter of expressions takes seconds on PoCL; other jobs would be blocked for that time.
#[test]
fn a_large_field_of_an_expression_takes_the_variant_that_a_small_one_has() {
    let Some(engine) = device() else { return };
    if engine.device().kind != DeviceKind::Cpu {
        return;
    }
    let expression = Expression::new(vec![Op::Field(0), Op::Binary(Binary::Add, 0, 0)]).expect("an expression");
    let evaluate = |dims: [u32; 3]| {
        let grid = Grid::new(dims, [1.0; 3]).expect("a grid");
        let samples = Samples::U8(vec![7; grid.sample_count() as usize]);
        let volume = engine.upload(grid, &samples, None).expect("a volume");
        engine.evaluate(&expression, &[&volume], &Never)
    };
    evaluate([16, 16, 16]).expect("a small field");
    engine.check_compiler(Box::new(|| Err("a variant is compiled".to_owned())));
    // More work-items than PoCL counts as few, if the launch is not bounded.
    evaluate([256, 256, 64]).expect("a large field");
}

#[test]
fn a_variant_of_a_kernel_is_compiled_only_if_the_compiler_may_run() {
    let Some(engine) = device() else { return };
    let source = "__kernel void count(__global uint *out) { out[0] = get_local_size(0); }";
    let program = engine.cx.build(source, "-cl-std=CL1.2").expect("it builds");
    let out = engine.cx.buffer::<u32>("test", 1).expect("a buffer");
    let launch = |groups, local| engine.cx.launch("test", program.get("count"), groups, local, &[&out]);
    launch(1, 1).expect("a launch");
    engine.check_compiler(Box::new(|| Err("the disk is full".to_owned())));
    launch(2, 1).expect("a variant that is there");
    for (groups, local) in [(1, 2), (1 << 17, 1)] {
        let refused = launch(groups, local).expect_err("a new variant");
        assert!(
            matches!(&refused, Error::Refused(why) if why == "the disk is full"),
            "{refused}"
        );
    }
    assert!(engine.cx.build(source, "-cl-std=CL1.2").is_err());
    engine.check_compiler(Box::new(|| Ok(())));
    launch(1, 2).expect("there is space again");
}
