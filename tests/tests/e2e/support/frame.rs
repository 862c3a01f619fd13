//! Frames of the server, read by `server/PROTOCOL.md` section 3 alone: nothing here uses the server's code.

use serde_json::Value;

/// A frame from the server, as the viewer's log keeps it.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame {
    Opening {
        bytes: u64,
        total_bytes: u64,
    },
    Opened {
        volume: Value,
        step: u64,
        edit: Value,
        device: Value,
        capabilities: Value,
    },
    Prefix(Prefix),
    Chunk {
        surface: u8,
        generation: u32,
        level: u8,
        region: [u32; 3],
        bytes: usize,
        triangles: usize,
    },
    Committed {
        surface: u8,
        generation: u32,
        level: u8,
        is_final: bool,
    },
    Done {
        surface: u8,
        generation: u32,
        trace: String,
        statistics: Value,
    },
    Measured {
        surface: u8,
        generation: u32,
        error: [f64; 2],
        regions: Vec<([u32; 3], [f64; 2])>,
    },
    Superseded {
        surface: u8,
        generation: u32,
    },
    Removed {
        surface: u8,
    },
    Stepped {
        step: u64,
    },
    Described {
        volume: Value,
        step: u64,
    },
    /// The members of the group.
    Group(Value),
    /// View of the member in control.
    Led(Value),
    /// Camera pose of the member in control.
    Posed(Value),
    Left {
        reason: String,
    },
    /// Distances of a region's vertices.
    Errors {
        surface: u8,
        generation: u32,
        region: [u32; 3],
        distances: Vec<f32>,
    },
    /// To a question.
    Answer {
        kind: String,
        generation: u32,
        answer: Value,
    },
    Error {
        code: String,
        message: String,
        open: bool,
        /// The surface of the generation, if a generation failed.
        surface: Option<u8>,
        suggested_triangles: Option<u64>,
    },
    Closed {
        code: Option<u16>,
    },
}

/// Contents of `prefix`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prefix {
    pub surface: u8,
    pub generation: u32,
    pub level: u8,
    /// Whether marching cubes made it, not the dual mesher.
    pub is_marched: bool,
    pub regions: usize,
    pub unchanged: usize,
    pub triangles: usize,
    pub is_final: bool,
}

impl Frame {
    /// The generation it carries, if it carries one.
    pub fn generation(&self) -> Option<u32> {
        match *self {
            Self::Prefix(Prefix { generation, .. })
            | Self::Chunk { generation, .. }
            | Self::Committed { generation, .. }
            | Self::Done { generation, .. }
            | Self::Measured { generation, .. }
            | Self::Superseded { generation, .. }
            | Self::Errors { generation, .. }
            | Self::Answer { generation, .. } => Some(generation),
            Self::Opening { .. }
            | Self::Opened { .. }
            | Self::Removed { .. }
            | Self::Stepped { .. }
            | Self::Described { .. }
            | Self::Group(_)
            | Self::Led(_)
            | Self::Posed(_)
            | Self::Left { .. }
            | Self::Error { .. }
            | Self::Closed { .. } => None,
        }
    }

    /// Reads a text frame. Panics on anything that `server/PROTOCOL.md` does not define.
    #[track_caller]
    pub fn read(text: &str) -> Self {
        let message = Message(serde_json::from_str(text).expect("a text frame is JSON"));
        match message.text("type").as_str() {
            "opening" => {
                message.has(&["bytes", "totalBytes"], &["device"]);
                Self::Opening {
                    bytes: message.number("bytes"),
                    total_bytes: message.number("totalBytes"),
                }
            }
            "opened" => {
                message.has(&["volume", "step", "edit", "device", "capabilities"], &[]);
                Self::Opened {
                    volume: message.0["volume"].clone(),
                    step: message.number("step"),
                    edit: message.0["edit"].clone(),
                    device: message.0["device"].clone(),
                    capabilities: message.0["capabilities"].clone(),
                }
            }
            "prefix" => {
                let fields = [
                    "surface",
                    "generation",
                    "level",
                    "kind",
                    "mesher",
                    "regions",
                    "unchanged",
                    "triangles",
                    "final",
                ];
                message.has(&fields, &[]);
                assert_eq!(message.text("kind"), "cut", "kind of chunks");
                let mesher = message.text("mesher");
                assert!(
                    ["dual", "marching-cubes"].contains(&mesher.as_str()),
                    "a mesher: {mesher}"
                );
                Self::Prefix(Prefix {
                    surface: message.surface(),
                    generation: message.generation(),
                    level: message.level(),
                    is_marched: mesher == "marching-cubes",
                    regions: message.number("regions") as usize,
                    unchanged: message.number("unchanged") as usize,
                    triangles: message.number("triangles") as usize,
                    is_final: message.boolean("final"),
                })
            }
            "committed" => {
                message.has(&["surface", "generation", "level", "final"], &[]);
                Self::Committed {
                    surface: message.surface(),
                    generation: message.generation(),
                    level: message.level(),
                    is_final: message.boolean("final"),
                }
            }
            "done" => {
                message.has(&["surface", "generation", "trace", "statistics"], &[]);
                let statistics = message.0["statistics"].clone();
                assert_statistics(&statistics);
                Self::Done {
                    surface: message.surface(),
                    generation: message.generation(),
                    trace: message.0["trace"].as_str().expect("a trace").to_owned(),
                    statistics,
                }
            }
            "measured" => {
                message.has(&["surface", "generation", "error", "regions"], &[]);
                let regions = message.0["regions"].as_array().expect("a list of regions");
                let region = |value: &Value| {
                    let region = serde_json::from_value(value["region"].clone()).expect("three counts");
                    (region, error_of(value))
                };
                Self::Measured {
                    surface: message.surface(),
                    generation: message.generation(),
                    error: error_of(&message.0["error"]),
                    regions: regions.iter().map(region).collect(),
                }
            }
            "superseded" => {
                message.has(&["surface", "generation"], &[]);
                Self::Superseded {
                    surface: message.surface(),
                    generation: message.generation(),
                }
            }
            "removed" => {
                message.has(&["surface"], &[]);
                Self::Removed {
                    surface: message.surface(),
                }
            }
            "probed" => {
                message.has(
                    &["surface", "generation", "position", "inside", "values", "nearest"],
                    &[],
                );
                message.answer()
            }
            "distribution" => {
                message.has(&["surface", "generation", "kind", "bins", "coarse", "coarseShare"], &[]);
                message.answer()
            }
            "annotated" => {
                message.has(&["surface", "generation", "annotation", "regions"], &[]);
                message.answer()
            }
            "curve" => {
                message.has(&["surface", "generation", "kind", "byError", "points"], &[]);
                message.answer()
            }
            "error" => {
                message.has(&["code", "message", "open"], &["surface", "suggestedTriangles"]);
                Self::Error {
                    code: message.text("code"),
                    message: message.text("message"),
                    open: message.boolean("open"),
                    surface: message.0["surface"].as_u64().map(|surface| surface as u8),
                    suggested_triangles: message.0["suggestedTriangles"].as_u64(),
                }
            }
            "stepped" => {
                message.has(&["step", "label"], &[]);
                Self::Stepped {
                    step: message.number("step"),
                }
            }
            "described" => {
                message.has(&["volume", "step"], &[]);
                Self::Described {
                    volume: message.0["volume"].clone(),
                    step: message.number("step"),
                }
            }
            "group" => {
                message.has(
                    &["group", "you", "control", "followers", "asks"],
                    &["people", "key", "leaderAway"],
                );
                Self::Group(message.0)
            }
            "led" => {
                message.has(&["volume", "step", "surfaces"], &[]);
                Self::Led(message.0)
            }
            "posed" => {
                message.has(&[], &["camera", "page"]);
                Self::Posed(message.0)
            }
            "left" => {
                message.has(&["reason"], &[]);
                Self::Left {
                    reason: message.text("reason"),
                }
            }
            other => panic!("a message of type {other:?}, which the page does not know"),
        }
    }
}

/// Root mean square and maximum; checks that the maximum is not the smaller one.
#[track_caller]
fn error_of(value: &Value) -> [f64; 2] {
    let [rms, max] = ["rms", "max"].map(|name| value[name].as_f64().unwrap_or_else(|| panic!("{name}: {value}")));
    assert!(0.0 <= rms && rms <= max, "an error of {rms} rms and {max} at most");
    [rms, max]
}

/// All names of the page's table, and others only in its manner.
#[track_caller]
fn assert_statistics(statistics: &Value) {
    let names = statistics.as_object().expect("statistics are an object");
    let expected = "mesher beta tolerance maxError topology featureRange gaveWay isTreeCut estimatedError error fullTriangles mesherTriangles removedParts \
                    removedTriangles unmatchedPositions activeCells leaves triangles vertices lostCubes unpatchedVertices stagesMs wallMs deviceBytes volumeBytes device";
    for name in expected.split_whitespace() {
        assert!(names.contains_key(name), "statistics without {name}: {statistics}");
    }
    if let Some(all) = statistics["mesherTriangles"].as_u64() {
        assert!(
            statistics["triangles"].as_u64() <= Some(all),
            "triangles of all: {statistics}"
        );
    }
    let snake: Vec<_> = names.keys().filter(|name| name.contains('_')).collect();
    assert!(snake.is_empty(), "names in camelCase, found {snake:?}");
    assert!(
        statistics["beta"].is_null() != statistics["tolerance"].is_null(),
        "β or a tolerance: {statistics}"
    );
    assert!(
        statistics["topology"] != "auto",
        "what holds of the topology: {statistics}"
    );
    if !statistics["error"].is_null() {
        error_of(&statistics["error"]);
    }
}

/// A text frame as JSON.
struct Message(Value);

impl Message {
    #[track_caller]
    fn text(&self, field: &str) -> String {
        let text = self.0[field].as_str();
        text.unwrap_or_else(|| panic!("{field} is text: {}", self.0)).to_owned()
    }

    #[track_caller]
    fn number(&self, field: &str) -> u64 {
        let number = self.0[field].as_u64();
        number.unwrap_or_else(|| panic!("{field} is a count: {}", self.0))
    }

    #[track_caller]
    fn boolean(&self, field: &str) -> bool {
        let boolean = self.0[field].as_bool();
        boolean.unwrap_or_else(|| panic!("{field} is true or false: {}", self.0))
    }

    #[track_caller]
    fn surface(&self) -> u8 {
        let surface = self.number("surface");
        assert!(surface <= 3, "surface {surface}, surfaces are 0 to 3");
        surface as u8
    }

    #[track_caller]
    fn generation(&self) -> u32 {
        self.number("generation") as u32
    }

    /// The answer to a question.
    #[track_caller]
    fn answer(&self) -> Frame {
        Frame::Answer {
            kind: self.text("type"),
            generation: self.generation(),
            answer: self.0.clone(),
        }
    }

    #[track_caller]
    fn level(&self) -> u8 {
        let level = self.number("level");
        assert!(level <= 5, "prefix {level}, levels are 0 to 5");
        level as u8
    }

    /// Checks that it has exactly the documented fields; optional ones may be missing.
    #[track_caller]
    fn has(&self, fields: &[&str], optional: &[&str]) {
        let object = self.0.as_object().expect("a message is an object");
        let is_plain = |key: &&str| *key != "type" && !optional.contains(key);
        let mut found: Vec<&str> = object.keys().map(String::as_str).filter(is_plain).collect();
        let mut expected = fields.to_vec();
        found.sort_unstable();
        expected.sort_unstable();
        assert_eq!(found, expected, "fields of {}", self.0["type"]);
    }
}
