"""Captions of Snakemake's report can be rendered with the default configuration and the parameters of their rules."""

import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from docutils.core import publish_parts
from jinja2 import Environment, StrictUndefined, UndefinedError
from snakemake.api import SnakemakeApi
from snakemake.logging import logger
from snakemake.settings.types import OutputSettings, ResourceSettings
from workflow_runs import ROOT

CAPTIONS = ROOT / "workflow" / "report"


class Wildcards:
    """Wildcards with a value for every name."""

    def __getattr__(self, name):
        return f"some_{name}"


@pytest.fixture(scope="module")
def loaded():
    """The configuration without defaults, as captions see it, and {caption file: [rule]} of the default study."""
    with pytest.MonkeyPatch.context() as patch, SnakemakeApi(OutputSettings()) as api:
        patch.chdir(ROOT)
        # The Snakefile changes the path of modules, the environment and the logger.
        patch.setattr(sys, "path", [*sys.path])
        patch.setattr(os, "environ", os.environ.copy())
        patch.setattr(logger, "handlers", [*logger.handlers])
        settings = ResourceSettings(cores=1)
        workflow = api.workflow(resource_settings=settings, snakefile=ROOT / "workflow" / "Snakefile")._workflow
        rules = {}
        for rule in workflow.rules:
            for output in rule.output:
                if shown := output.flags.get("report"):
                    path = Path(shown.caption.get_path_or_uri(secret_free=True)).resolve()
                    rules.setdefault(path.name, []).append(rule)
        yield workflow.globals["config"], rules


def rendered(text, config, rule, wildcards):
    """HTML of a caption. Unknown names fail, as unknown keys of `config` do in Snakemake."""
    params = {}
    for name, value in rule.params.items():
        try:
            params[name] = value(wildcards) if callable(value) else value
        except KeyError as error:  # no such comparison in the default study
            params[name] = str(error.args[0])
    names = SimpleNamespace(params=SimpleNamespace(**params), wildcards=wildcards, config=config)
    environment = Environment(trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    return publish_parts(environment.from_string(text).render(snakemake=names), writer="html5")["body"]


def test_every_caption_can_be_rendered(loaded):
    config, rules = loaded
    assert rules.keys() == {path.name for path in CAPTIONS.glob("*.rst")}
    for name, shown in rules.items():
        for rule in shown:
            try:
                html = rendered((CAPTIONS / name).read_text(), config, rule, Wildcards())
            except UndefinedError as error:
                pytest.fail(f"workflow/report/{name}, rule {rule.name}: {error}")
            assert "<p>" in html and "system-message" not in html, (name, html)


def test_key_without_a_value_in_the_configuration_is_found(loaded):
    config, rules = loaded
    with pytest.raises(UndefinedError, match="statistics"):
        rendered('{{ snakemake.config["statistics"]["threshold"] }}', config, rules["trust.rst"][0], Wildcards())
