# The two commands of the README: `make demo` and `make test`. Set-up goes into .venv.
.PHONY: demo test test-slow setup cycles extras clean

GRAYCAST = .venv/bin/graycast

demo: setup
	$(GRAYCAST) generate configs/demo.yaml --out out/demo
	$(GRAYCAST) validate out/demo
	$(GRAYCAST) preview configs/demo.yaml --out out/demo/preview.png

test: setup
	.venv/bin/ruff check src tests examples
	.venv/bin/ruff format --check src tests examples
	.venv/bin/pytest -n 2 --dist loadfile

test-slow: setup
	.venv/bin/pytest -n 2 --dist loadfile -m 'slow and not gpu'

setup:
	@scripts/setup

# Optional: the second back end, Blender Cycles, in an environment of its own.
cycles:
	@scripts/setup-cycles

# Optional: detectors and robots. PyTorch comes with CUDA's libraries, 5 GB on disk.
extras: setup
	@scripts/setup-extras

clean:
	rm -rf .venv .venv-cycles out build
