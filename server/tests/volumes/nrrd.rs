//! NRRD and MetaImage: round trips, axes, channels.

use isopeel_kernels::SampleType;
use isopeel_volumes::{Frame, LengthUnit, read_file};

use crate::formats::{DIMS, all, memory, open, same, same_placed, values};
use crate::write::{self, Volume};

#[test]
fn nrrd_round_trips() {
    for v in all() {
        for encoding in ["raw", "gzip", "bzip2", "hex", "text"] {
            let what = format!("{encoding} {:?}", v.kind);
            same_placed(&open("a.nrrd", write::nrrd(&v, encoding)).unwrap(), &v, &what);
        }
        let header = write::nrrd_header(&v, "raw") + "data file: a.raw\n";
        let location = memory(vec![("a.nhdr", header.into()), ("a.raw", v.bytes())]);
        same_placed(&read_file(&location).unwrap(), &v, "detached");
    }
}

#[test]
fn nrrd_skips_lines_and_bytes() {
    let v = Volume::new(DIMS, 1, ('i', 2), true);
    let with = |lines: &str, data: Vec<u8>, encoding| {
        let header = write::nrrd_header(&v, encoding) + lines + "data file: a.dat\n";
        read_file(&memory(vec![("a.nhdr", header.into()), ("a.dat", data)]))
    };
    let before = |head: &[u8], tail: Vec<u8>| [head, &tail].concat();
    same(
        &with("byte skip: 3\n", before(b"abc", v.bytes()), "raw").unwrap(),
        &v,
        "byte skip",
    );
    same(
        &with("byteskip: -1\n", before(b"abcdef", v.bytes()), "raw").unwrap(),
        &v,
        "byte skip -1",
    );
    same(
        &with("line skip: 2\n", before(b"one\ntwo\n", v.bytes()), "raw").unwrap(),
        &v,
        "line skip",
    );
    let both = before(b"one\n", write::gzip(&before(b"abc", v.bytes())));
    same(
        &with("lineskip: 1\nbyte skip: 3\n", both, "gzip").unwrap(),
        &v,
        "line, then bytes of the decoded stream",
    );
    let error = with("line skip: 9\n", b"one\ntwo\n".to_vec(), "raw").unwrap_err();
    assert_eq!(error.field, "line skip");
    let error = with("byte skip: -1\n", write::gzip(&v.bytes()), "gzip").unwrap_err();
    assert_eq!(error.field, "byte skip");
}

#[test]
fn the_oldest_nrrd_is_read_and_a_place_that_is_not_known_is_0() {
    let text = "NRRD00.01\ntype: uchar\ndimension: 3\nsizes: 2 2 2\nspace dimension: 3\nspace directions: (1,0,0) (0,1,0) (0,0,1)\n\
                space origin: (nan,2,nan)\nencoding: raw\n\n12345678";
    let file = open("a.nrrd", text.into()).unwrap();
    assert_eq!(file.geometry.origin, [0.0, 2.0, 0.0]);
    let notices = file.notices.text().unwrap();
    assert!(
        notices.contains("place of the first sample is missing in [NaN, 2.0, NaN]"),
        "{notices}"
    );
}

#[test]
fn a_space_with_time_has_its_steps_at_its_times() {
    let text = "NRRD0005\ntype: uchar\ndimension: 4\nsizes: 2 2 2 2\nspace: left-posterior-superior-time\nkinds: space space space time\n\
                space directions: (2,0,0,0) (0,1,0,0) (0,0,1,0) (0,0,0,0.5)\nspace origin: (1,2,3,4)\n\
                space units: \"mm\" \"mm\" \"mm\" \"s\"\nencoding: raw\n\n0123456789abcdef";
    let file = open("a.nrrd", text.into()).unwrap();
    let geometry = &file.geometry;
    assert_eq!((geometry.spacing, geometry.origin), ([2.0, 1.0, 1.0], [1.0, 2.0, 3.0]));
    assert_eq!((geometry.frame, file.steps), (Frame::Lps, 2));
    let times = file.times.and_then(|times| times.labels()).unwrap();
    assert_eq!(times, ["4 s", "4.5 s"]);
    let turned = text.replace("(0,1,0,0)", "(0,1,0,1)");
    assert_eq!(open("a.nrrd", turned.into()).unwrap_err().field, "space directions");
}

#[test]
fn centers_are_words_in_any_case() {
    for word in ["cell", "Cell"] {
        let text = format!(
            "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 2 2\naxis mins: 0 0 0\naxis maxs: 2 4 6\n\
             centers: {word} {word} {word}\nencoding: raw\n\n12345678"
        );
        let geometry = open("a.nrrd", text.into()).unwrap().geometry;
        assert_eq!((geometry.spacing, geometry.origin), ([1.0, 2.0, 3.0], [0.5, 1.0, 1.5]));
    }
}

#[test]
fn metaimage_has_the_unit_and_the_lengths_of_rows_that_it_says() {
    let text = |unit: &str, row: &str| {
        format!(
            "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementSpacing = 1 2 3\nTransformMatrix = {row} 0 1 0 0 0 1\n\
             AnatomicalOrientation = LPS\nDistanceUnits = {unit}\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n12345678"
        )
    };
    let read = |unit, row| open("a.mha", text(unit, row).into_bytes()).unwrap();
    assert_eq!(read("um", "1 0 0").geometry.unit, Some(LengthUnit::Micrometre));
    assert_eq!(read("?", "1 0 0").geometry.unit, Some(LengthUnit::Millimetre));
    let file = read("mm", "2 0 0");
    assert_eq!(file.geometry.spacing, [2.0, 2.0, 3.0]);
    assert!(file.notices.text().unwrap().contains("[2.0, 1.0, 1.0]"));
}

#[test]
fn nrrd_time_may_run_fastest() {
    let v = Volume::new([2, 3, 2], 2, ('u', 1), false);
    let mut file = b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 2 2 3 2\nkinds: list domain domain domain\n\
        spacings: nan 1 2 3\nencoding: raw\n\n"
        .to_vec();
    (0..12).for_each(|i| file.extend([v.values[i] as u8, v.values[12 + i] as u8]));
    let read = open("a.nrrd", file).unwrap();
    same(&read, &v, "interleaved");
    assert_eq!(read.geometry.spacing, [1.0, 2.0, 3.0]);
}

#[test]
fn nrrd_values_are_read_in_any_case() {
    let v = Volume::new(DIMS, 1, ('i', 2), true);
    let header = write::nrrd_header(&v, "GZIP")
        .replace("int16", "Int16")
        .replace("big", "Big")
        .replace("domain", "Domain");
    let bytes = [header.into_bytes(), b"\n".to_vec(), write::gzip(&v.bytes())].concat();
    same_placed(&open("A.NRRD", bytes).unwrap(), &v, "capitals");
}

/// Channels beside each other, after the grid, and between its axes; with time steps.
#[test]
fn nrrd_channels_are_fields_wherever_they_stand() {
    let axes = [
        ("x", "2", "domain"),
        ("y", "3", "space"),
        ("z", "2", "domain"),
        ("t", "2", "time"),
        ("c", "2", "vector"),
    ];
    for order in [
        [4, 0, 1, 2, 3],
        [0, 1, 2, 3, 4],
        [0, 1, 4, 2, 3],
        [3, 4, 0, 1, 2],
        [4, 3, 2, 1, 0],
    ] {
        let of = |pick: fn(&(&'static str, &'static str, &'static str)) -> &'static str| {
            order.map(|i| pick(&axes[i])).join(" ")
        };
        let mut file = format!(
            "NRRD0004\ntype: uchar\ndimension: 5\nsizes: {}\nkinds: {}\nencoding: raw\n\n",
            of(|a| a.1),
            of(|a| a.2)
        )
        .into_bytes();
        // The value of each sample encodes its position.
        let weights = [1, 2, 6, 12, 24];
        let size = |axis: usize| axes[axis].1.parse::<u32>().unwrap();
        for mut i in 0..48 {
            let mut value = 0;
            for axis in order {
                value += i % size(axis) * weights[axis];
                i /= size(axis);
            }
            file.push(value as u8);
        }
        let read = open("a.nrrd", file).unwrap();
        // The first axis of the file is x.
        let dims = if order[2] == 2 && order[0] == 4 {
            [2, 3, 2]
        } else {
            read.geometry.dims
        };
        assert_eq!((read.geometry.dims, read.steps), (dims, 2));
        let reversed = order == [4, 3, 2, 1, 0];
        for (c, field) in read.fields.iter().enumerate() {
            assert_eq!(field.name, ["a x", "a y"][c]);
            for step in 0..2 {
                let expected: Vec<f32> = (0..12)
                    .map(|i| if reversed { i / 6 + i / 2 % 3 * 2 + i % 2 * 6 } else { i })
                    .map(|i| (i + step * 12 + c as u32 * 24) as f32)
                    .collect();
                assert_eq!(values(&field.source.load(step).unwrap()), expected, "{order:?}");
            }
        }
    }
}

#[test]
fn colours_become_their_luminance() {
    let samples: Vec<u8> = (0..8).flat_map(|i| [10 * i, 200, 255 - i, 77]).collect();
    let expected: Vec<f32> = (0..8)
        .map(|i| (0.2126 * f64::from(10 * i) + 0.7152 * 200.0 + 0.0722 * f64::from(255 - i)) as f32)
        .collect();
    let of = |kinds: &str, sizes: &str, samples: Vec<u8>| {
        let header = format!("NRRD0004\ntype: uchar\ndimension: 4\nsizes: {sizes}\nkinds: {kinds}\nencoding: raw\n\n");
        let read = open("a.nrrd", [header.into_bytes(), samples].concat()).unwrap();
        assert_eq!((read.fields.len(), read.fields[0].sample_type), (1, SampleType::F32));
        values(&read.fields[0].source.load(0).unwrap())
    };
    assert_eq!(
        of("RGBA-color domain domain domain", "4 2 2 2", samples.clone()),
        expected
    );
    let planes: Vec<u8> = (0..4)
        .flat_map(|c| samples.iter().skip(c).step_by(4).copied().collect::<Vec<_>>())
        .collect();
    assert_eq!(of("domain domain domain RGBA-color", "2 2 2 4", planes), expected);
}

#[test]
fn metaimage_channels_are_fields() {
    let v = Volume::new([4, 3, 10], 1, ('i', 2), true);
    for compressed in [false, true] {
        let header =
            write::meta_header(&v, compressed, "LOCAL").replace("3 10\n", "3 5\nElementNumberOfChannels = 2\n");
        let data = if compressed { write::zlib(&v.bytes()) } else { v.bytes() };
        let read = open("a.mha", [header.into_bytes(), data].concat()).unwrap();
        for (c, field) in read.fields.iter().enumerate() {
            assert_eq!(field.name, ["a 1", "a 2"][c]);
            let expected: Vec<f32> = v.values.iter().skip(c).step_by(2).map(|&v| v as f32).collect();
            assert_eq!(values(&field.source.load(0).unwrap()), expected);
        }
    }
}

#[test]
fn nrrd_axes_and_missing_value() {
    let v = Volume::new(DIMS, 1, ('i', 2), false);
    let mut header = write::nrrd_header(&v, "raw");
    let at = header.find("space directions").unwrap();
    let end = at + header[at..].find('\n').unwrap();
    header.replace_range(at..end, "space directions: (0, 2, 0) (-0.5,0,0) (0,3,4)");
    // The frame of vectors is passed over.
    header += "_FillValue:=-32768\nsample units: \"HU\"\nmeasurement frame: (0,1,0) (-1,0,0) (0,0,1)\n\n";
    let read = open("a.nrrd", [header.into_bytes(), v.bytes()].concat()).unwrap();
    assert_eq!(read.geometry.spacing, [2.0, 0.5, 5.0]);
    assert_eq!(
        read.geometry.direction,
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]
    );
    assert_eq!(
        (read.fields[0].missing, read.fields[0].unit.as_deref()),
        (Some(-32768.0), Some("HU"))
    );
}

#[test]
fn metaimage_round_trips() {
    for v in all() {
        for compressed in [false, true] {
            let what = format!("compressed {compressed} {:?}", v.kind);
            same_placed(&open("a.mha", write::mha(&v, compressed)).unwrap(), &v, &what);
        }
        let header = write::meta_header(&v, false, "sub/a.raw");
        let location = memory(vec![("a.mhd", header.clone().into()), ("sub/a.raw", v.bytes())]);
        same_placed(&read_file(&location).unwrap(), &v, "detached");
        let header = format!("HeaderSize = -1\n{header}");
        let location = memory(vec![
            ("a.mhd", header.into()),
            ("sub/a.raw", [b"any head".to_vec(), v.bytes()].concat()),
        ]);
        same_placed(&read_file(&location).unwrap(), &v, "header size -1");
    }
}

#[test]
fn metaimage_rows_of_the_matrix_are_axes() {
    let v = Volume::new(DIMS, 1, ('u', 1), false);
    let file = [
        b"TransformMatrix = 0 1 0 -1 0 0 0 0 1\n".to_vec(),
        write::mha(&v, false),
    ]
    .concat();
    let read = open("a.mha", file).unwrap();
    assert_eq!(
        read.geometry.direction,
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    );
}

#[test]
fn axes_without_a_unit_have_that_of_the_others() {
    let opened = |units: &str| {
        let header = format!(
            "NRRD0005\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 2\nunits: {units}\nencoding: raw\n\n"
        );
        let location = memory(vec![("a.nrrd", [header.as_bytes(), b"12345678"].concat())]);
        let dataset = read_file(&location).unwrap();
        let unit = dataset.geometry.unit.map(|unit| unit.symbol().to_owned());
        (unit, dataset.notices.text().unwrap_or_default())
    };
    for units in [r#""um" "um" """#, r#""um" "???" "um""#] {
        let (unit, notice) = opened(units);
        assert_eq!(unit.as_deref(), Some("µm"), "{units}");
        assert!(notice.contains("1 of 3 axes have no unit"), "{notice}");
    }
    let (unit, notice) = opened(r#""um" "mm" """#);
    assert!(
        unit.is_none() && notice.contains("the units of the axes differ"),
        "{notice}"
    );
    assert_eq!(opened(r#""" "" """#).0, None);
}
