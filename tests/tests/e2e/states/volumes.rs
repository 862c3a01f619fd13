//! Small volumes of odd shapes, and the names that edits of each may use.

use std::path::{Path, PathBuf};

use fastrand::Rng;

use crate::support::ball::write_field;

/// A volume that all sequences share.
#[derive(Clone, Copy)]
pub struct Volume {
    /// Its id, and the name of its file or folder.
    pub name: &'static str,
    pub dims: [u32; 3],
    pub isovalues: &'static [f64],
    /// Values of `field`; empty: it is not changed.
    pub fields: &'static [&'static str],
    /// Values of `mask`, besides null.
    pub masks: &'static [&'static str],
    pub features: &'static [&'static str],
    /// Time steps.
    pub steps: u64,
}

/// A volume with missing samples: surfaces end at these.
pub const MISSING: &str = "missing";

const DERIVED: &[&str] = &[
    "none",
    "gradient-magnitude",
    "mean-curvature",
    "gaussian-curvature",
    "local-variance",
];
const NOISE: &[f64] = &[0.0, 0.3, -0.4, 0.9, 1.6, 0.300_000_01, -0.0, 1e-9, 5.0];

const PLAIN: Volume = Volume {
    name: "",
    dims: [2; 3],
    isovalues: NOISE,
    fields: &[],
    masks: &[],
    features: DERIVED,
    steps: 1,
};

/// All of them.
pub const VOLUMES: &[Volume] = &[
    Volume {
        name: "spheres",
        dims: [48; 3],
        isovalues: &[0.0, -2.0, 3.0, 8.0, 5.5, -0.0, 40.0],
        ..PLAIN
    },
    Volume {
        name: "two",
        isovalues: &[0.5, 0.0, 1.0, 0.25, 1e-9],
        ..PLAIN
    },
    Volume {
        name: "stick",
        dims: [3, 150, 3],
        ..PLAIN
    },
    Volume {
        name: "slab",
        dims: [70, 40, 2],
        ..PLAIN
    },
    Volume {
        name: MISSING,
        dims: [34, 26, 24],
        ..PLAIN
    },
    Volume {
        name: "constant",
        dims: [20; 3],
        isovalues: &[7.0, 6.5, 8.0, 7.000_000_5],
        ..PLAIN
    },
    Volume {
        name: "levels",
        dims: [34, 25, 20],
        isovalues: &[4.0, 5.0, 3.0, 4.5, 8.0, 0.0, 1.0],
        ..PLAIN
    },
    Volume {
        name: "large-values",
        dims: [37, 20, 24],
        isovalues: &[1e8, 1.05e8, 9.2e7, 100_000_008.0],
        ..PLAIN
    },
    Volume {
        name: "fields",
        dims: [36, 34, 30],
        isovalues: &[0.0, 0.4, -0.5, 1.2],
        fields: &["f", "g", "f*f + 0.1*g", "f - 0.2*g", "max(f,g*0.1)", "abs(f)", "labels"],
        masks: &[
            "labels==3",
            "labels==1",
            "labels!=3",
            "labels==1,3..4",
            "labels>0",
            "f>-1",
            "g<=0",
            "labels!=99",
            "labels==99",
        ],
        features: &[
            "none",
            "g",
            "gradient-magnitude",
            "mean-curvature",
            "local-variance",
            "distance(labels==3)",
            "distance(f>1)",
            "labels",
            "f*f",
        ],
        ..PLAIN
    },
    Volume {
        name: "vector",
        dims: [36, 20, 24],
        isovalues: &[0.0, 0.4, -0.5, 1.2],
        fields: &["u", "v", "w", "magnitude(u,v,w)", "u*v"],
        masks: &["u>0", "w<0.5"],
        features: &[
            "none",
            "v",
            "vector-magnitude(u,v,w)",
            "divergence(u,v,w)",
            "vorticity-magnitude(u,v,w)",
            "q-criterion(u,v,w)",
            "lambda2(u,v,w)",
            "helicity(u,v,w)",
            "gradient-magnitude",
            "divergence(v,u,w)",
        ],
        ..PLAIN
    },
    Volume {
        name: "steps",
        dims: [33, 30, 22],
        isovalues: &[0.0, 0.3, -0.4, 1.1],
        fields: &["f", "f*f", "abs(f)", "labels"],
        masks: &["labels==1", "labels==2", "labels==0", "labels==1..2"],
        features: &[
            "none",
            "gradient-magnitude",
            "labels",
            "f*f",
            "distance(labels==1)",
            "distance(labels==2)",
        ],
        steps: 5,
    },
    Volume {
        name: "bricks",
        dims: [34, 36, 66],
        isovalues: &[0.0, 0.5, 1.0, 1.5, -1.0],
        ..PLAIN
    },
];

/// A sequence's own file.
pub const OWN: &str = "own";
/// A sequence's own numbered files.
pub const SERIES: &str = "series";
/// A sequence's own upload.
pub const UPLOADED: &str = "uploaded";
const OWN_DIMS: [u32; 3] = [20, 34, 18];
/// Volumes that change while a sequence is played.
pub const CHANGING: &[Volume] = &[
    Volume {
        name: OWN,
        dims: OWN_DIMS,
        ..PLAIN
    },
    Volume {
        name: SERIES,
        dims: OWN_DIMS,
        steps: FIRST_STEPS,
        ..PLAIN
    },
    Volume {
        name: UPLOADED,
        dims: OWN_DIMS,
        ..PLAIN
    },
];
/// Steps of a series before it grows.
pub const FIRST_STEPS: u64 = 3;

impl Volume {
    /// The volume of that name.
    pub fn named(name: &str) -> &'static Self {
        let found = VOLUMES.iter().chain(CHANGING).find(|volume| volume.name == name);
        found.unwrap_or_else(|| panic!("no volume {name:?}"))
    }

    /// A random position in the world, which is index space.
    pub fn position(&self, random: &mut Rng) -> [f64; 3] {
        self.dims.map(|n| {
            let at = random.f64() * f64::from(n - 1);
            (at * 1000.0).round() / 1000.0
        })
    }

    /// Length of its diagonal.
    pub fn size(&self) -> f64 {
        self.dims.iter().map(|&n| f64::from(n - 1).powi(2)).sum::<f64>().sqrt()
    }
}

/// A sum of waves with random directions and phases: mean 0, deviation 1. `rate`: radians a sample.
fn waves(seed: u64, rate: f32) -> impl Fn([f32; 3]) -> f32 {
    const COUNT: usize = 8;
    let mut random = Rng::with_seed(seed);
    let wave: [[f32; 4]; COUNT] = std::array::from_fn(|_| {
        let direction = [0; 3].map(|_| random.f32() - 0.5);
        let length = direction.iter().map(|d| d * d).sum::<f32>().sqrt().max(0.01);
        let scale = rate * (0.5 + random.f32()) / length;
        let [x, y, z] = direction.map(|d| d * scale);
        [x, y, z, random.f32() * std::f32::consts::TAU]
    });
    move |[x, y, z]| {
        let value = |[a, b, c, phase]: [f32; 4]| (a * x + b * y + c * z + phase).sin();
        wave.into_iter().map(value).sum::<f32>() / 2.0
    }
}

/// `inside`, but this value on the faces.
fn closed(dims: [u32; 3], face: f32, inside: impl Fn([f32; 3]) -> f32) -> impl Fn([f32; 3]) -> f32 {
    move |at| {
        let is_face = (0..3).any(|axis| at[axis] == 0.0 || at[axis] == (dims[axis] - 1) as f32);
        if is_face { face } else { inside(at) }
    }
}

fn distance(at: [f32; 3], centre: [f32; 3]) -> f32 {
    (0..3).map(|axis| (at[axis] - centre[axis]).powi(2)).sum::<f32>().sqrt()
}

fn label(noise: f32, [x, y, z]: [f32; 3]) -> f32 {
    if noise > 1.2 {
        7.0
    } else if z < 15.0 && y > 25.0 {
        4.0
    } else if z > 18.0 && x > 18.0 {
        3.0
    } else if x > 10.0 && y > 8.0 {
        1.0
    } else {
        0.0
    }
}

/// Writes one of the volumes that change; other contents have another range.
pub fn write_changing(path: &Path, content: u64) {
    let (noise, scale) = (waves(1000 + content, 0.5), 1.0 + content as f32 / 7.0);
    let new = path.with_extension("new");
    write_field(&new, OWN_DIMS, |at| noise(at) * scale);
    std::fs::rename(new, path).expect("renamed");
}

/// Writes all of them to a folder; their paths.
pub fn write_all(folder: &Path) -> Vec<PathBuf> {
    let write = |name: &str, value: &dyn Fn([f32; 3]) -> f32| {
        let path = folder.join(format!("{name}.npy"));
        write_field(&path, Volume::named(name).dims, value);
    };
    let rough = waves(1, 0.9);
    write(
        "spheres",
        &closed([48; 3], -20.0, |at| {
            let large = 14.0 - distance(at, [20.0, 24.0, 23.0]);
            large.max(6.0 - distance(at, [39.0, 10.0, 37.0])) + 0.25 * rough(at)
        }),
    );
    write("two", &|[x, y, z]| (x + y + z + 1.0) % 2.0);
    write("stick", &waves(2, 0.9));
    write("slab", &waves(3, 0.6));
    let noise = waves(6, 0.6);
    write(MISSING, &|at| {
        let [x, y, z] = at;
        let is_hole = (15.0..26.0).contains(&x) && (12.0..20.0).contains(&y) && (8.0..16.0).contains(&z);
        if is_hole || at == [22.0; 3] {
            f32::NAN
        } else {
            noise(at)
        }
    });
    write("constant", &|_| 7.0);
    let noise = waves(7, 0.5);
    write("levels", &|at| (noise(at) * 2.0 + 4.0).clamp(0.0, 8.0).round());
    let noise = waves(8, 0.6);
    write("large-values", &|at| noise(at) * 1e7 + 1e8);
    write("bricks", &closed(Volume::named("bricks").dims, -5.0, waves(40, 0.4)));
    write_folders(folder);
    VOLUMES
        .iter()
        .map(|volume| {
            let file = folder.join(format!("{}.npy", volume.name));
            if file.exists() { file } else { folder.join(volume.name) }
        })
        .collect()
}

/// Volumes of several fields: folders with a file for each.
fn write_folders(folder: &Path) {
    let write = |volume: &str, file: &str, value: &dyn Fn([f32; 3]) -> f32| {
        let folder = folder.join(volume);
        std::fs::create_dir_all(&folder).expect("a folder");
        write_field(&folder.join(format!("{file}.npy")), Volume::named(volume).dims, value);
    };
    write(
        "fields",
        "f",
        &closed(Volume::named("fields").dims, -4.0, waves(9, 0.5)),
    );
    let slow = waves(11, 0.25);
    write("fields", "g", &|at| slow(at) * 10.0);
    let noise = waves(10, 0.3);
    write("fields", "labels", &|at| label(noise(at), at));
    for (name, seed) in [("u", 20), ("v", 21), ("w", 22)] {
        write("vector", name, &waves(seed, 0.5));
    }
    let (first, second) = (waves(30, 0.5), waves(31, 0.5));
    for step in 0..Volume::named("steps").steps {
        let angle = 0.25 * step as f32;
        // One half stays as it is.
        write("steps", &format!("f_{step:03}"), &|at| {
            if at[1] < 15.0 {
                first(at)
            } else {
                first(at) * angle.cos() + second(at) * angle.sin()
            }
        });
        let low = 3.0 * step as f32;
        write("steps", &format!("labels_{step:03}"), &|[x, y, z]| {
            if y >= 20.0 && x < 10.0 {
                2.0
            } else {
                f32::from((low..low + 9.0).contains(&z))
            }
        });
    }
}
