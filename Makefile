# The two commands of the README: `make demo` and `make test`. Set-up goes into .venv.
.PHONY: demo test test-slow test-gpu setup setup-test cycles extras javascript reference schemas docs release clean

GRAYCAST = .venv/bin/graycast

demo: setup
	$(GRAYCAST) generate configs/demo.yaml --out out/demo
	$(GRAYCAST) validate out/demo
	$(GRAYCAST) preview configs/demo.yaml --out out/demo/preview.png

# Bytecode is kept also where the environment forbids it: pytest writes assertions anew into every
# file of tests otherwise, in both workers, which is a third of the time until the first test.
test test-slow: export PYTHONDONTWRITEBYTECODE =
test: setup-test
	.venv/bin/ruff check src tests examples benchmarks studies docs/*.py
	.venv/bin/ruff format --check src tests examples benchmarks studies docs/*.py
	.venv/bin/mypy
	.venv/bin/pytest $(PYTEST_OPTIONS) -n 2 --dist loadfile

# The quick tests once more, with the axes and types of all arrays checked at each call; then the slow ones.
test-slow: setup-test
	.venv/bin/pytest $(PYTEST_OPTIONS) -n 2 --dist loadfile --jaxtyping-packages=graycast,beartype.beartype
	.venv/bin/pytest $(PYTEST_OPTIONS) -n 2 --dist loadfile -m 'slow and not gpu' --durations=20

# What needs an NVIDIA GPU: tests/gpu/README.md.
test-gpu: setup-test
	.venv/bin/pytest -m gpu tests/gpu

# What Graycast itself needs, in the versions of constraints.txt.
setup:
	@scripts/setup

# The packages for tests, style, types, documentation and twins, in addition to those above.
setup-test:
	@scripts/setup test,twin,docs

# The pages of docs/reference that come from the program: commands, keys, materials and the glossary.
reference: setup
	.venv/bin/python docs/reference_pages.py

# JSON Schemas of all YAML files in out/schema, where .vscode/settings.json looks for them.
schemas: setup
	mkdir -p out/schema
	for kind in config rig stack study design robot tool; do \
		$(GRAYCAST) schema $$kind > out/schema/$$kind.json || exit 1; done

# The documentation as a site: out/site/index.html.
docs: setup-test reference
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict --quiet

# Optional: the second back end, Blender Cycles, in an environment of its own.
cycles:
	@scripts/setup-cycles

# Optional: detectors and robots. PyTorch comes with CUDA's libraries, 6 to 7 GB on disk.
extras:
	@scripts/setup-extras

# Optional: TypeScript's checker and a formatter for the scripts of the pages, and Pyright.
javascript:
	@scripts/setup-javascript

# The wheel and the sdist in dist, checked in fresh environments. Nothing is uploaded.
release: setup-test
	@scripts/release

clean:
	rm -rf .venv .venv-cycles .venv-javascript out build dist
