# make          set up and run the default study
# make test     set up and run the tests
# make tiny     the whole workflow in a minute or two
# make docs     this documentation as a site, into site/
# make report   the default study's report in one page, and one to flip through slices
PYTHON ?= python3
CORES ?= 2
VENV := .venv
BIN := $(VENV)/bin
# What pip must find installed before it builds pyradiomics.
BUILD_FIRST = $(shell grep -E '^(setuptools|wheel|numpy)==' environment-pip.txt)

.PHONY: study setup test tiny abdomen report docs clean

study: setup
	$(BIN)/snakemake --cores $(CORES)

setup: $(VENV)/installed

$(VENV)/installed: environment-pip.txt workflow/build/sitecustomize.py
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(BUILD_FIRST)
	PYTHONPATH='$(CURDIR)/workflow/build' $(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-build-isolation -r environment-pip.txt
	touch $@

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

clean:
	rm -rf site results results-tiny results-abdomen results-large results-paper .snakemake
