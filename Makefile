# The front door. `make demo` and `make test` each do everything that is missing: packages, build, run.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

BUILD ?= build
PREFIX ?= /usr/local
PRESET ?= release
OUT ?= out
JOBS ?= $(shell nproc)
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PACKAGES := $(shell sed -n '/^[^#]/p' cmake/packages.txt)
SOURCES = $(shell git ls-files '*.cpp' '*.hpp')

FUZZ_SECONDS ?= 120
CRASH_MINUTES ?= 100
SOAK_MINUTES ?= 60
FUZZERS := fuzz_simulate fuzz_to_image fuzz_to_mesh fuzz_fold fuzz_refine fuzz_enhance fuzz_obj fuzz_ply fuzz_frames fuzz_points fuzz_hdf5 fuzz_scene fuzz_material fuzz_archive

.PHONY: help setup configure build programs demo test bench lint format sanitize sanitize-threads coverage fuzz crash soak scale clean compose-demo dataset model viewer proto-descriptor install deb python

help: ## print this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-18s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# Asks dpkg first, so that a machine with everything installed needs neither root nor a network.
setup: ## install the Debian packages that are missing (as root, or with sudo)
	@missing=""; for p in $(PACKAGES); do dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then \
	  echo "setup: installing$$missing"; \
	  $(SUDO) apt-get update -qq; \
	  $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing >/dev/null; \
	fi; echo "setup: all packages are installed"

configure: setup
	@[ -f $(BUILD)/build.ninja ] || { echo "build: configuring preset $(PRESET)"; cmake --preset $(PRESET) >$(BUILD)-configure.log 2>&1 || { cat $(BUILD)-configure.log; exit 1; }; rm -f $(BUILD)-configure.log; }

build: configure ## configure and build everything into build/
	@echo "build: compiling with $(JOBS) jobs"
	@cmake --build $(BUILD) -j $(JOBS)

programs: configure
	@echo "build: compiling the programs with $(JOBS) jobs"
	@cmake --build $(BUILD) -j $(JOBS) --target programs

install: programs ## install the programs and what comes with them below PREFIX (/usr/local) and DESTDIR
	@DESTDIR="$(DESTDIR)" cmake --install $(BUILD) --prefix "$(PREFIX)" >/dev/null
	@echo "install: $(DESTDIR)$(PREFIX)/bin/pleat"

deb: programs ## Debian packages of the programs, the SDK and the package for Python, in build/packages
	@$(MAKE) --no-print-directory setup PACKAGES="dpkg-dev"
	@cpack --config $(BUILD)/CPackConfig.cmake >$(BUILD)/cpack.log || { tail -20 $(BUILD)/cpack.log; exit 1; }
	@ls $(BUILD)/packages/*.deb

demo: programs ## simulate and enhance the falling tablecloth; pictures in out/demo/report.html
	@echo "demo: deploy/scenes/draping.json with the shipped model"
	@$(BUILD)/bin/pleat run deploy/scenes/draping.json --reference --out $(OUT)/demo
	@echo "demo: open $(OUT)/demo/report.html in a browser"

test: build ## build and run all tests
	@ctest --test-dir $(BUILD) --output-on-failure -j $(JOBS)

bench: build ## print the benchmark tables; writes out/bench/report.json and lean-rival.json
	@mkdir -p $(OUT)/bench
	@$(BUILD)/bin/pleat bench
	@$(BUILD)/bin/pleat bench --json >$(OUT)/bench/report.json
	@echo "bench: the lean rival, a direct simulation of the fine sheet"
	@$(BUILD)/bin/bench_lean_rival --json $(OUT)/bench/lean-rival.json
	@echo "bench: $(OUT)/bench/report.json $(OUT)/bench/lean-rival.json"

dataset: build ## generate the DRAPING training data into out/dataset/draping
	@$(BUILD)/bin/pleat dataset generate $(OUT)/dataset/draping --set draping --frames 120 --extra 24

model: build ## train the default model from out/dataset/draping into out/train/draping
	@$(BUILD)/bin/pleat-train deploy/models/draping.train.json

crash: programs ## kill -9 random processes while jobs run, CRASH_MINUTES (tests/reliability/README.md)
	@/usr/bin/python3 tests/reliability/crash.py $(BUILD)/bin/pleat --minutes $(CRASH_MINUTES)

soak: programs ## live sessions among jobs, flooders and silent clients, SOAK_MINUTES
	@/usr/bin/python3 tests/reliability/soak.py $(BUILD)/bin/pleat --minutes $(SOAK_MINUTES) --judge

lint: setup ## formatting, static checks and the rules of the rooms
	@cmake/lint.sh $(BUILD)

format: setup ## format all sources in place
	@clang-format -i $(SOURCES)

scale: programs ## frames, sequences and training steps by 1 to 4 processes in shares of a core, and what they cost (as root)
	@/usr/bin/python3 tests/bench/scale/scale.py $(BUILD) --json $(OUT)/scale.json

sanitize: setup ## build with address and undefined-behaviour sanitizers and run the tests under them
	@cmake --preset asan-ubsan >/dev/null && cmake --build --preset asan-ubsan -j $(JOBS)
	@ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1 ctest --test-dir build-asan --output-on-failure -LE 'browser|bench'

sanitize-threads: setup ## the same with the sanitizer of threads
	@cmake --preset tsan >/dev/null && cmake --build --preset tsan -j $(JOBS)
	@TSAN_OPTIONS=halt_on_error=1:second_deadlock_stack=1 ctest --test-dir build-tsan --output-on-failure -LE 'browser|bench'

coverage: setup ## run the tests and print which share of the lines of common and services they run; pages in out/coverage
	@$(MAKE) --no-print-directory setup PACKAGES="gcovr"
	@cmake --preset coverage >/dev/null && cmake --build --preset coverage -j $(JOBS)
	@find build-coverage -name '*.gcda' -delete
	@ctest --test-dir build-coverage --output-on-failure -j $(JOBS) -LE 'browser|bench'
	@/usr/bin/python3 cmake/coverage.py build-coverage $(OUT)/coverage

fuzz: setup ## fuzz the inputs of services and the readers of files, FUZZ_SECONDS each, JOBS at once (tests/fuzz/README.md)
	@$(MAKE) --no-print-directory setup PACKAGES="clang libclang-rt-14-dev"
	@cmake --preset fuzz >build-fuzz-configure.log 2>&1 || { cat build-fuzz-configure.log; exit 1; }; rm -f build-fuzz-configure.log
	@cmake --build build-fuzz -j $(JOBS) --target $(FUZZERS)
	@printf '%s\n' $(FUZZERS) | xargs -P $(JOBS) -I '{}' tests/fuzz/fuzz.sh build-fuzz '{}' $(FUZZ_SECONDS)

compose-demo: ## build the container images and run the demo job against them
	@docker/compose-demo.sh $(OUT)/compose-demo

viewer: ## rebuild the viewer inside report.html (needs npm; the built one is committed)
	@cd services/presentation/viewer && npm ci --no-fund --no-audit && npm run build

python: setup ## build wheel and sdist of the package for Python into build/python/dist
	@common/client/python/build.sh $(BUILD)/python

proto-descriptor: ## renew the committed descriptor of the wire contract after adding to it
	@protoc -I proto --include_imports --descriptor_set_out=proto/pleat/v1/descriptor.binpb proto/pleat/v1/*.proto

clean: ## remove everything that was built or made
	rm -rf build build-* $(OUT) .cache
