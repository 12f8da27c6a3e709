# make          set up and run the default study
# make test     set up and run the tests
# make tiny     the whole workflow in a minute or two
# make setup-fetch   set up, with what `snakemake fetch` needs
# make setup-proof   set up, with the second simulator of the blind validation
# make docs     this documentation as a site, into site/
# make report   the default study's report in one page, and one to flip through slices
# make clean    delete results, the site, and compiled code
# make lock     the hashes of the packages of environment-*.txt (pip, fetch, proof), into .lock files; needs uv
PYTHON ?= python3
CORES ?= 2
VENV := .venv
BIN := $(VENV)/bin
UV ?= uv
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PIP_INSTALL := $(PIP) --require-hashes
# What pip must find installed before it builds pyradiomics; with its hashes, on the lines that follow.
BUILD_FIRST := sed -nE '/^(setuptools|wheel|numpy)==/,/[^\]$$/p' environment-pip.lock

.PHONY: study setup setup-fetch setup-proof test tiny abdomen report docs lock clean

study: setup
	$(BIN)/snakemake --cores $(CORES)

setup: $(VENV)/installed

$(VENV)/installed: environment-pip.lock workflow/build/sitecustomize.py pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BUILD_FIRST) >$(VENV)/build-first.lock
	$(PIP_INSTALL) -r $(VENV)/build-first.lock
	PYTHONPATH='$(CURDIR)/workflow/build' $(PIP_INSTALL) --no-build-isolation -r environment-pip.lock
	$(PIP) --no-index --no-deps --no-build-isolation --editable .
	touch $@

setup-fetch: setup
	$(PIP_INSTALL) -r environment-fetch.lock

setup-proof: setup
	$(PIP_INSTALL) --no-deps -r environment-proof.lock

test: setup
	$(BIN)/python -m pytest -n $(CORES) --dist loadfile

tiny: setup
	$(BIN)/snakemake --cores $(CORES) --configfile config/tiny.yaml

abdomen: setup
	$(BIN)/snakemake --cores $(CORES) --configfile config/abdomen.yaml

report: setup
	$(BIN)/snakemake report_page --cores $(CORES)

docs: setup
	$(BIN)/mkdocs build --strict

# The .txt files name all packages, so that nothing is to be resolved. Hashes of all platforms and Pythons.
lock:
	for name in pip fetch proof; do \
		$(UV) pip compile environment-$$name.txt --no-deps --universal --python-version 3.11 --generate-hashes --no-annotate \
			--no-emit-index-url --custom-compile-command 'make lock' --quiet --output-file environment-$$name.lock || exit 1; \
	done

clean:
	rm -rf site results results-tiny results-abdomen results-large results-paper results-quick-proof .snakemake
	find workflow -name __pycache__ -prune -exec rm -rf {} +
