//! The commands of README, CONTRIBUTING, docs and docker. The list states for each command that it is run here as written, or the test or
//! script that runs it, or why none does. A new or changed command fails until it is in the list.

use std::collections::HashMap;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{command, http, process, repository};

/// Programs that commands of the pages begin with. Other indented lines are formulas, answers and files.
const PROGRAMS: [&str; 22] = [
    "apt-get", "cargo", "cat", "cmake", "curl", "docker", "echo", "export", "isopeel", "kubectl", "ls", "make",
    "mkdir", "ninja", "openssl", "python3", "rm", "sbatch", "ssh", "sudo", "sudoedit", "tar",
];

/// How a command is tested.
#[derive(Debug)]
enum How {
    /// It is run here and must succeed.
    Run,
    /// It is run here as a server, until the page starts another one.
    Serve,
    /// This file runs it: its path, and words that it has.
    By(&'static str, &'static str),
    /// Nothing runs it, for this reason.
    Not(&'static str),
}
use How::{By, Not, Run, Serve};

const COMPOSE: &str = "tests/scripts/compose.sh";
const DIST: &str = "packaging/dist.sh";
const KUBERNETES: &str = "tests/scripts/kubernetes.py";
const DRIVERS: &str = "tests/scripts/drivers.sh";
const NO_CLUSTER: &str = "no cluster of Kubernetes is at hand";
const OTHER_GPU: &str = "no GPU of AMD or Intel is at hand";

#[rustfmt::skip]
const COMMANDS: &[(&str, &[(&str, How)])] = &[
    ("README.md", &[
        ("make run", By("tests/scripts/fresh-debian.sh", "make run")),
        ("make test", By(".ci/run", "make test")),
        ("isopeel serve head.nrrd scans/", Serve),
        ("isopeel extract head.nrrd --iso 517 -o head.glb", Run),
        ("isopeel extract head.nrrd --iso 517 --triangles 10% -o head.stl", Run),
        ("isopeel batch request.json -o surfaces", Run),
        ("isopeel batch 'scans/*.nii.gz' --iso 300 --format stl -o surfaces", Run),
        ("isopeel info head.nrrd", Run),
        ("isopeel slice head.nrrd --axis z --index 54 -o slice.png", Run),
        ("isopeel devices", Run),
    ]),
    ("CONTRIBUTING.md", &[("make test", By(".ci/run", "make test"))]),
    ("docs/algorithm.md", &[
        ("cargo test -p isopeel-reference --test expected_cuts", By("Makefile", "cargo test --locked --workspace --tests")),
        ("cargo test -p isopeel-reference", By("Makefile", "cargo test --locked --workspace --tests")),
    ]),
    ("docs/command-line.md", &[
        ("isopeel extract head.nrrd --triangles 20% -o head.glb --surface '{\"name\":\"skin\",\"iso\":300,\"color\":\"#d2b48c\",\"opacity\":0.4}' --surface \
          '{\"name\":\"bone\",\"iso\":900}' --surface '{\"volume\":\"labels.nii.gz\",\"label\":\"Hippocampus\",\"color\":\"#3465a4\"}'", Run),
        ("isopeel slice head.nrrd --axis z --index 54 -o slice.png", Run),
        ("isopeel slice head.nrrd --axis z --index 54 --iso 300,900 -o contours.svg", Run),
    ]),
    ("docs/embedding.md", &[
        ("isopeel serve --no-auth --embed-origin http://localhost:3000 head.nrrd", Serve),
        ("isopeel token create --state-folder DIR --user lab-site --role view", Run),
        ("isopeel serve --state-folder DIR --embed-origin https://lab.example head.nrrd", Serve),
        ("curl -X POST https://volumes.example/api/v1/embed-tokens -H \"Authorization: Bearer $TOKEN_OF_THE_SITE\" -H \"Content-Type: application/json\" \
          -d '{\"roles\": [\"view\"], \"seconds\": 600}'", Run),
    ]),
    ("docs/fidelity.md", &[
        ("tests/scripts/fidelity.py --work FOLDER", Not("takes hours, and volumes that are not in the repository")),
        ("tests/scripts/fidelity.py --work FOLDER --parts shading", Not("takes volumes that are not in the repository")),
    ]),
    ("docs/gallery.md", &[
        ("tests/scripts/simulate.py", By("Makefile", "tests/scripts/simulate.py --small")),
        ("isopeel serve target/simulations/hurricane.nc target/simulations/fluid/fluid.pvd", By("Makefile", "target/simulations/hurricane.nc target/simulations/fluid/fluid.pvd")),
    ]),
    ("docs/jobs.md", &[
        ("isopeel serve head.nrrd --state-folder /var/lib/isopeel", Serve),
        ("isopeel jobs submit request.json --watch", Run),
        ("isopeel jobs fetch ID -o surfaces", Run),
        ("isopeel batch request.json -o surfaces", Run),
        ("isopeel batch 'scans/*.nii.gz' more/ --iso 300 --triangles 10% --format stl -o surfaces", Run),
    ]),
    ("docs/opencl-drivers.md", &[
        ("isopeel devices --check", By("Makefile", "devices --check")),
        ("cmake -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX=/opt/pocl -DLLVM_CONFIG=/usr/bin/llvm-config-16 -DENABLE_ICD=ON \
          -DENABLE_TESTS=OFF -DENABLE_EXAMPLES=OFF -DENABLE_POCLCC=OFF -DPOCL_ICD_ABSOLUTE_PATH=ON ..", Not("builds another PoCL from its sources")),
        ("ninja install", Not("builds another PoCL from its sources")),
        ("OCL_ICD_VENDORS=/etc/opt/pocl/OpenCL/vendors driver-tests/run.sh", Not("needs another PoCL")),
        ("ISOPEEL_DATA=FOLDER STEPS=surfaces tests/scripts/drivers.sh bookworm/pocl trixie/pocl forky/pocl intel", Not("takes volumes that are not in the repository")),
        ("python3 -m venv ~/intel-opencl", By(DRIVERS, "python3 -m venv")),
        ("~/intel-opencl/bin/pip install -r tests/scripts/drivers-requirements.txt", By(DRIVERS, "drivers-requirements.txt")),
        ("rm ~/intel-opencl/lib/libOpenCL.so*", By(DRIVERS, "libOpenCL.so")),
        ("mkdir ~/intel-opencl/vendors", By(DRIVERS, "vendors")),
        ("echo ~/intel-opencl/lib/libintelocl.so > ~/intel-opencl/vendors/intel.icd", By(DRIVERS, "libintelocl.so")),
        ("export OCL_ICD_VENDORS=~/intel-opencl/vendors LD_LIBRARY_PATH=~/intel-opencl/lib", By(DRIVERS, "OCL_ICD_VENDORS")),
        ("isopeel devices", Run),
    ]),
    ("docs/releases.md", &[
        ("tar xzf isopeel-0.2.0-x86_64-linux.tar.gz", By(DIST, "tar --extract --gzip")),
        ("sudo install isopeel-0.2.0-x86_64-linux/isopeel /usr/local/bin/", By(DIST, "\"./$2/isopeel\" extract")),
        ("sudo apt-get install ocl-icd-libopencl1 pocl-opencl-icd", By(DIST, "ocl-icd-libopencl1,pocl-opencl-icd")),
        ("sudo apt-get install ./isopeel_0.2.0_amd64.deb", By(DIST, "apt-get install --yes")),
        ("sudoedit /etc/isopeel/isopeel.toml", By("server/src/cli/settings.rs", "packaging/isopeel.toml")),
        ("sudo systemctl enable --now isopeel", By("tests/scripts/service.sh", "systemctl enable --now isopeel")),
        ("docker save isopeel:cpu | xz >isopeel-cpu.tar.xz", By(COMPOSE, "docker save")),
    ]),
    ("docs/reliability.md", &[
        ("make fuzz", Not("takes hours")),
        ("ISOPEEL_STATES_SECONDS=600 cargo test --locked --package isopeel-tests --test e2e -- states:: --nocapture", By("Makefile", "--test e2e -- states:: --nocapture")),
        ("ISOPEEL_STATES_FILE=failed.json cargo test --locked --package isopeel-tests --test e2e -- states:: --nocapture", By("tests/tests/e2e/states/mod.rs", "states.jsonl")),
    ]),
    ("docs/security.md", &[
        ("isopeel serve --listen unix:$XDG_RUNTIME_DIR/isopeel.sock head.nrrd", By("tests/tests/e2e/unix.rs", "unix:{}")),
        ("ssh -L 8417:/run/user/1000/isopeel.sock login.example", Not("takes another machine")),
        ("isopeel serve --public-url https://volumes.example --oidc-issuer https://login.example --oidc-client-id isopeel --oidc-client-secret-file secret \
          --oidc-scope \"openid profile groups\" --oidc-role staff=edit,export --oidc-role '*=view' /srv/volumes", By("tests/browser/sign_in.test.mjs", "--oidc-role")),
        ("isopeel token create --state-folder DIR --user ann --role edit --role export --expires 30d", Run),
        ("isopeel token list --state-folder DIR", Run),
        ("isopeel token revoke --state-folder DIR ID", Run),
    ]),
    ("docs/uploads.md", &[
        ("isopeel serve head.nrrd --uploads /var/lib/isopeel/uploads --state-folder /var/lib/isopeel/state", Serve),
        ("curl -H \"$AUTH\" -H 'Content-Type: application/json' SERVER/api/v1/uploads -d '{\"files\":[{\"name\":\"head.mhd\",\"bytes\":312},{\"name\":\"head.raw\",\"bytes\":16777216}]}'", Run),
        ("cat head.mhd head.raw | curl -H \"$AUTH\" -X PATCH -H 'Upload-Offset: 0' -H 'Content-Type: application/offset+octet-stream' --data-binary @- SERVER/api/v1/uploads/ID", Run),
        ("curl -H \"$AUTH\" -X POST SERVER/api/v1/uploads/ID/finish", Run),
    ]),
    ("docs/how-to/amd-gpu.md", &[
        ("isopeel devices", Run),
        ("isopeel devices --check", By("Makefile", "devices --check")),
        ("isopeel serve --device gfx head.nrrd", Not(OTHER_GPU)),
        ("docker build -f docker/Dockerfile --target mesa…", By("tests/scripts/containers.sh", "mesa")),
    ]),
    ("docs/how-to/five-people.md", &[
        ("openssl req -x509…", By("tests/tests/e2e/documentation.rs", "five-people.md")),
        ("isopeel serve --listen 0.0.0.0:8417 --tls-cert cert.pem --tls-key key.pem --public-url https://volumes.example:8417 --state-folder state --uploads uploads /srv/volumes",
         By("tests/tests/e2e/documentation.rs", "server_line")),
        ("for user in ann bob cem dua eva; do…", By("tests/tests/e2e/documentation.rs", "five-people.md")),
    ]),
    ("docs/how-to/glb-by-curl.md", &[
        ("isopeel serve head.nrrd", Serve),
        ("SERVER=http://127.0.0.1:8417 TOKEN=…", By("tests/tests/e2e/documentation.rs", "glb-by-curl.md")),
    ]),
    ("docs/how-to/many-files-on-a-cluster.md", &[
        ("ls /scratch/study/*.nii.gz >list", Run),
        ("sbatch --array=0-9 docker/isopeel-batch.slurm list surfaces --iso 300 --triangles 10% --format glb", By("tests/scripts/slurm.sh", "isopeel-batch.slurm")),
        ("isopeel batch '/scratch/study/*.nii.gz' --iso 300 --triangles 10% --format glb -o surfaces", Run),
    ]),
    ("docker/README.md", &[
        ("docker compose -f docker/compose.yaml up --build", By(COMPOSE, "up --detach")),
        ("docker compose -f docker/compose.yaml --profile gpu up --build gpu", Not("needs a machine with a GPU and Docker")),
        ("ISOPEEL_DATA=~/scans docker compose -f docker/compose.yaml up", By(COMPOSE, "ISOPEEL_DATA=")),
        ("docker compose -f docker/compose.yaml exec cpu isopeel token create --user ann --role edit --role export", By(COMPOSE, "isopeel token create --user ann")),
        ("openssl rand -hex 32 >token", By(COMPOSE, "openssl rand -hex 32")),
        ("docker compose -f docker/compose.yaml -f docker/compose.tls.yaml up", By(COMPOSE, "-f docker/compose.tls.yaml")),
        ("docker build -f docker/Dockerfile --target intel -t isopeel:intel .", By("tests/scripts/containers.sh", "intel")),
        ("docker run --init -v isopeel:/var/lib/isopeel --device /dev/dri --group-add \"$(stat --format %g /dev/dri/renderD128)\" -p 127.0.0.1:8417:8417 isopeel:intel", Not(OTHER_GPU)),
        ("kubectl create namespace isopeel", By(KUBERNETES, "def check_readme")),
        ("openssl rand -hex 32 | tr -d '\\n' >token", Run),
        ("kubectl --namespace isopeel create secret generic isopeel-token --from-file=token", By(KUBERNETES, "def check_readme")),
        ("kubectl apply -k docker/kubernetes/base", By(KUBERNETES, "kustomize")),
        ("kubectl --namespace isopeel port-forward service/isopeel 8417", Not(NO_CLUSTER)),
        ("kubectl --namespace isopeel exec isopeel-0 -- isopeel token create --user ann --role edit --expires 30d", Not(NO_CLUSTER)),
    ]),
];

/// The commands of a page, in their order: indented lines, joined if they continue on the next line, and the first line of each block of
/// bash.
fn commands_of(page: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(page).unwrap_or_else(|error| panic!("{}: {error}", page.display()));
    let (mut found, mut fence) = (Vec::new(), None::<bool>);
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            // The first line of bash identifies the block.
            let is_bash = fence.is_none() && language == "bash";
            fence = if fence.is_none() { Some(is_bash) } else { None };
            if is_bash {
                found.extend(lines.next().map(shortened));
            }
            continue;
        }
        let Some(mut command) = line.strip_prefix("    ").filter(|_| fence.is_none()).map(str::to_owned) else {
            continue;
        };
        while let Some(rest) = command.strip_suffix('\\') {
            let next = lines.next().unwrap_or_default();
            command = format!("{} {}", rest.trim_end(), next.trim_start());
        }
        found.extend(is_command(&command).then(|| shortened(&command)));
    }
    found
}

/// Whether a line begins with a program, behind variables.
fn is_command(line: &str) -> bool {
    let is_variable = |word: &&str| {
        word.split_once('=')
            .is_some_and(|(name, _)| name.bytes().all(|b| b.is_ascii_uppercase() || b == b'_'))
    };
    let program = line
        .split_whitespace()
        .find(|word| !is_variable(word))
        .unwrap_or_default();
    PROGRAMS.contains(&program)
        || program.starts_with("tests/scripts/")
        || program.starts_with("driver-tests/")
        || program.starts_with("~/")
}

/// Removes the trailing comment.
fn shortened(line: &str) -> String {
    line.split(" # ").next().unwrap_or_default().trim().to_owned()
}

/// A command of the list that ends in dots is the first line of a block.
fn is_equal(found: &str, listed: &str) -> bool {
    listed
        .strip_suffix('…')
        .map_or(found == listed, |beginning| found.starts_with(beginning))
}

/// The pages whose commands these are.
fn pages() -> Vec<String> {
    let root = repository();
    let mut pages = vec!["README.md".to_owned(), "CONTRIBUTING.md".to_owned()];
    for folder in ["docs", "docs/how-to", "docker"] {
        let entries = std::fs::read_dir(root.join(folder)).expect("a folder");
        let names = entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"));
        pages.extend(
            names
                .filter(|name| name.ends_with(".md"))
                .map(|name| format!("{folder}/{name}")),
        );
    }
    pages
}

#[test]
fn each_command_of_the_documentation_is_in_the_list_and_run_by_what_it_names() {
    let listed: HashMap<&str, &[(&str, How)]> = COMMANDS.iter().copied().collect();
    for page in pages() {
        let expected: Vec<&str> = listed
            .get(page.as_str())
            .into_iter()
            .flat_map(|lines| lines.iter().map(|line| line.0))
            .collect();
        let found = commands_of(&repository().join(&page));
        let equal = found.len() == expected.len()
            && found
                .iter()
                .zip(&expected)
                .all(|(found, expected)| is_equal(found, expected));
        assert!(
            equal,
            "{page} has the commands\n{}\nexpected\n{}",
            found.join("\n"),
            expected.join("\n")
        );
    }
    let (mut here, mut elsewhere, mut none) = (0, 0, Vec::new());
    for (page, line, how) in COMMANDS
        .iter()
        .flat_map(|(page, lines)| lines.iter().map(move |(line, how)| (page, line, how)))
    {
        match how {
            Run | Serve => here += 1,
            By(file, words) => {
                let text =
                    std::fs::read_to_string(repository().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
                assert!(
                    text.contains(words),
                    "{file} has no {words}, expected it to run: {line}"
                );
                elsewhere += 1;
            }
            Not(why) => none.push(format!("{page}: {line}: {why}")),
        }
    }
    println!(
        "{} commands: {here} are run here, {elsewhere} by other tests, {} by none:\n{}",
        here + elsewhere + none.len(),
        none.len(),
        none.join("\n")
    );
}

#[test]
fn pages_and_images_name_this_version() {
    let version = env!("CARGO_PKG_VERSION");
    for (file, words) in [
        (
            "docker/Dockerfile",
            format!("org.opencontainers.image.version=\"{version}\""),
        ),
        (
            "docker/kubernetes/base/kustomization.yaml",
            format!("newTag: {version}-cpu"),
        ),
        (
            "docker/kubernetes/gpu/kustomization.yaml",
            format!("newTag: {version}-gpu"),
        ),
        ("docs/releases.md", format!("isopeel-{version}-x86_64-linux.tar.gz")),
        ("docs/releases.md", format!("isopeel_{version}_amd64.deb")),
        ("CHANGELOG.md", format!("## [{version}]")),
    ] {
        let text = std::fs::read_to_string(repository().join(file)).expect("a file");
        assert!(text.contains(&words), "{file} has no {words}");
    }
}

/// A folder with the files that the pages name.
struct Folder {
    root: tempfile::TempDir,
    server: Option<process::Process>,
    /// Values that replace SERVER, ID and other placeholders in commands of the page.
    names: HashMap<&'static str, String>,
}

/// Falls from 1400 at the centre by 40 a sample.
fn head(at: [f32; 3]) -> i16 {
    let squares = at.map(|x| (x - 31.5) * (x - 31.5));
    (1400.0 - 40.0 * squares.iter().sum::<f32>().sqrt()) as i16
}

fn samples() -> Vec<u8> {
    let at = |n: u32| [n % 64, n / 64 % 64, n / 4096].map(|x| x as f32);
    (0..64 * 64 * 64).flat_map(|n| head(at(n)).to_le_bytes()).collect()
}

/// A NIfTI file of 16-bit samples.
fn nifti(samples: &[u8]) -> Vec<u8> {
    let mut header = vec![0; 352];
    header[..4].copy_from_slice(&348_i32.to_le_bytes());
    for (at, value) in [(40, 3), (42, 64), (44, 64), (46, 64), (70, 4), (72, 16)] {
        header[at..at + 2].copy_from_slice(&i16::to_le_bytes(value));
    }
    for (at, value) in [(80, 1.0_f32), (84, 1.0), (88, 1.0), (108, 352.0), (112, 1.0)] {
        header[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    header[344..348].copy_from_slice(b"n+1\0");
    header.extend(samples);
    header
}

impl Folder {
    fn new() -> Self {
        let root = tempfile::tempdir().expect("a folder");
        let write = |name: &str, bytes: &[u8]| std::fs::write(root.path().join(name), bytes).expect("a file");
        for name in ["scans", "more", "scratch", "scratch/study", "bin"] {
            std::fs::create_dir(root.path().join(name)).expect("a folder");
        }
        let samples = samples();
        let header = b"NRRD0004\ntype: int16\ndimension: 3\nsizes: 64 64 64\nendian: little\nencoding: raw\n\n";
        write("head.nrrd", &[&header[..], &samples].concat());
        for name in ["scans/a.nii", "scans/b.nii", "more/c.nii", "scratch/study/d.nii"] {
            write(name, &nifti(&samples));
        }
        // 1 inside, 0 outside.
        let labels: Vec<u8> = samples
            .chunks(2)
            .flat_map(|sample| i16::from(sample[1] < 2).to_le_bytes())
            .collect();
        write("labels.nii", &nifti(&labels));
        write("labels.tsv", b"index\tname\tcolor\n1\tHippocampus\t#3465a4\n");
        write("head.mhd", format!("{:<311}\n", "ObjectType = Image\nNDims = 3\nDimSize = 256 256 256\nElementType = MET_UCHAR\nElementSpacing = 1 1 1\nElementDataFile = head.raw").as_bytes());
        write(
            "head.raw",
            &(0..1 << 24)
                .map(|n: u32| if n % 256 < 100 { 200 } else { 10 })
                .collect::<Vec<u8>>(),
        );
        let jobs = std::fs::read_to_string(repository().join("docs/jobs.md")).expect("the page");
        let request = jobs
            .split("```json\n")
            .nth(1)
            .and_then(|rest| rest.split("```").next())
            .expect("a request");
        write("request.json", request.as_bytes());
        // `volume` is an id on a server, and a path without one.
        write("here.json", request.replace("\"head\"", "\"head.nrrd\"").as_bytes());
        write(".curlrc", b"fail\nsilent\nshow-error\n");
        std::os::unix::fs::symlink(command::binary(), root.path().join("bin/isopeel")).expect("a link");
        let folder = Self {
            root,
            server: None,
            names: HashMap::new(),
        };
        folder.bash("gzip scans/*.nii more/*.nii scratch/study/*.nii labels.nii");
        folder
    }

    fn path(&self, name: &str) -> String {
        self.root.path().join(name).display().to_string()
    }

    /// Runs a line, which must succeed; returns its output.
    fn bash(&self, line: &str) -> String {
        let path = std::env::var("PATH").expect("a path");
        let name = |name: &str| self.names.get(name).map_or("", String::as_str);
        let output = Command::new("bash")
            .args(["-euo", "pipefail", "-c", line])
            .current_dir(self.root.path())
            .env("PATH", format!("{}:{path}", self.path("bin")))
            .env("CURL_HOME", self.root.path())
            .env("ISOPEEL_SERVER", name("SERVER"))
            .env("ISOPEEL_TOKEN_FILE", self.path("token-of-the-server"))
            .env("AUTH", format!("Authorization: Bearer {}", name("TOKEN")))
            .env("TOKEN_OF_THE_SITE", name("MADE"))
            .stdin(Stdio::null())
            .output()
            .expect("bash");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{line}: {said}{}",
            String::from_utf8_lossy(&output.stdout)
        );
        String::from_utf8(output.stdout).expect("text")
    }

    /// A command with names of this folder and of the server of the page.
    fn here(&self, line: &str) -> String {
        let mut line = line
            .replace("batch request.json", "batch here.json")
            .replace("/var/lib/isopeel", &self.path("lib"))
            .replace("/scratch/", &self.path("scratch/"));
        for (name, value) in &self.names {
            line = match *name {
                "SERVER" => line
                    .replace("SERVER/", &format!("{value}/"))
                    .replace("https://volumes.example", value),
                "ID" => line
                    .split(' ')
                    .map(|word| if word == "ID" { value } else { word })
                    .collect::<Vec<_>>()
                    .join(" ")
                    .replace("/ID", &format!("/{value}")),
                _ => line,
            };
        }
        line
    }

    fn run(&mut self, line: &str) {
        let printed = self.bash(&self.here(line));
        if let Some(token) = printed.trim().strip_prefix("isop_") {
            self.names.insert("MADE", printed.trim().to_owned());
            self.names
                .insert("ID", token.split('_').next().unwrap_or_default().to_owned());
        } else if let Some((_, rest)) = printed.split_once("\"id\":\"") {
            self.names
                .insert("ID", rest.split('"').next().unwrap_or_default().to_owned());
        } else if line.contains("jobs submit") {
            let is_id = |word: &&str| word.len() == 32 && word.bytes().all(|b| b.is_ascii_hexdigit());
            let id = printed.split_whitespace().find(is_id);
            self.names
                .insert("ID", id.unwrap_or_else(|| panic!("no id: {printed}")).to_owned());
        }
    }

    fn serve(&mut self, line: &str) {
        self.server = None;
        let line = self.here(line);
        let words = line.split_whitespace().skip(2);
        let words: Vec<String> = words
            .map(|word| {
                if self.root.path().join(word).exists() {
                    self.path(word)
                } else {
                    word.to_owned()
                }
            })
            .collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let Some((server, printed)) = process::begin(&[], &words) else {
            return;
        };
        let token = printed.split_once("#token=").map_or("", |(_, token)| token);
        std::fs::write(self.path("token-of-the-server"), format!("{token}\n")).expect("a file");
        self.names.insert("SERVER", format!("http://{}", server.address));
        self.names.insert("TOKEN", token.to_owned());
        assert_eq!(http::get(server.address, "/").status, 200, "{line}");
        self.server = Some(server);
    }
}

#[test]
fn the_commands_of_the_pages_run_as_they_are_written() {
    for (page, lines) in COMMANDS {
        let mut folder = Folder::new();
        for (line, how) in *lines {
            match how {
                Run => folder.run(line),
                Serve => folder.serve(line),
                By(..) | Not(_) => {}
            }
        }
        println!("{page}");
    }
}
