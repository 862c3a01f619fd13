//! Generates `web/src/protocol/generated.ts`: TypeScript declarations of the types that the server serialises, and the limits that it
//! shares with the web client. `make generated` writes the file. A test fails if the file is stale.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use isopeel_kernels::transfer::MAX_POINTS;
use isopeel_kernels::{MAX_LEVEL, REGION_CELLS};
use isopeel_view::FieldExpression;
use ts_rs::{Config, TS, TypeVisitor};

use crate::jobs::JobInfo;
use crate::problem::Problem;
use crate::rest::{EmbedInfo, SessionInfo, UnreadablePath, VolumeSummary};
use crate::service::VolumeInfo;
use crate::uploads::UploadList;
use crate::wire::messages::{ClientMessage, SUBPROTOCOL, ServerMessage};

const HEADER: &str = "/** Generated from the server's types: `make generated` writes it anew. */\n";

/// Declarations of the visited types, and of all types that they contain, by name.
struct Declarations {
    config: Config,
    by_name: BTreeMap<String, String>,
}

impl TypeVisitor for Declarations {
    fn visit<T: TS + 'static + ?Sized>(&mut self) {
        // Primitives and containers have no path, and need no declaration.
        if T::output_path().is_none() {
            return;
        }
        let declaration = format!("{}export {}", T::docs().unwrap_or_default(), T::decl(&self.config));
        if self
            .by_name
            .insert(T::ident(&self.config), formatted(&declaration))
            .is_none()
        {
            T::visit_dependencies(self);
        }
    }
}

/// Formats a declaration: one field per line, indented, and short comments on one line.
fn formatted(declaration: &str) -> String {
    let (mut text, mut depth, mut comment) = (String::new(), 0, Vec::new());
    let mut push = |depth: usize, line: &str| writeln!(text, "{}{line}", "  ".repeat(depth)).expect(INFALLIBLE);
    for line in declaration.replace(", }", ",\n}").lines().map(str::trim) {
        if line == "/**" {
            comment.clear();
        } else if let Some(sentence) = line.strip_prefix("* ") {
            comment.push(sentence);
        } else if line != "*/" {
            let (opened, closed) = (line.matches('{').count(), line.matches('}').count());
            let leading = usize::from(line.starts_with('}'));
            depth -= leading;
            push(depth, line);
            depth = depth + opened + leading - closed;
        } else if let [sentence] = comment[..] {
            push(depth, &format!("/** {sentence} */"));
        } else {
            push(depth, "/**");
            comment
                .iter()
                .for_each(|sentence| push(depth, &format!(" * {sentence}")));
            push(depth, " */");
        }
    }
    text
}

const INFALLIBLE: &str = "writing to a string cannot fail";

fn generate() -> String {
    let mut declarations = Declarations {
        // A `number` of TypeScript is exact up to 2⁵³, and no count here is larger.
        config: Config::new().with_large_int("number"),
        by_name: BTreeMap::new(),
    };
    declarations.visit::<ClientMessage>();
    declarations.visit::<ServerMessage>();
    declarations.visit::<VolumeInfo>();
    declarations.visit::<VolumeSummary>();
    declarations.visit::<UnreadablePath>();
    declarations.visit::<Problem>();
    declarations.visit::<UploadList>();
    declarations.visit::<SessionInfo>();
    declarations.visit::<JobInfo>();
    declarations.visit::<EmbedInfo>();
    let constants = [
        (
            "Levels are 0 (finest) to `LEVELS` - 1.",
            "LEVELS",
            (MAX_LEVEL.get() + 1).to_string(),
        ),
        ("Cells along a region's edge.", "REGION_CELLS", REGION_CELLS.to_string()),
        (
            "Maximum number of control points.",
            "MAX_POINTS",
            MAX_POINTS.to_string(),
        ),
        (
            "Subprotocol of the WebSocket.",
            "SUBPROTOCOL",
            format!("{SUBPROTOCOL:?}"),
        ),
        (
            "Functions of expressions over fields.",
            "EXPRESSION_FUNCTIONS",
            format!("{:?} as const", FieldExpression::functions()),
        ),
    ];
    let mut text = String::from(HEADER);
    for (comment, name, value) in constants {
        write!(text, "\n/** {comment} */\nexport const {name} = {value};\n").expect(INFALLIBLE);
    }
    for declaration in declarations.by_name.values() {
        write!(text, "\n{declaration}").expect(INFALLIBLE);
    }
    text
}

#[test]
fn client_types_are_fresh() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../web/src/protocol/generated.ts");
    let generated = generate();
    if std::env::var_os("UPDATE_GENERATED").is_some() {
        std::fs::write(&path, &generated).expect("write the client's types");
    }
    let committed = std::fs::read_to_string(&path).expect("read the client's types");
    assert!(
        committed == generated,
        "{} is stale: run `make generated`",
        path.display()
    );
}
