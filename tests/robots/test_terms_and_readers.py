"""Observation terms and readers of contracts are classes that anybody may add."""

import gc
import json

import numpy as np
import pytest
import yaml
from msgspec.structs import replace

from perdure.envs import task_of_environment, task_spec
from perdure.errors import PerdureError
from perdure.robots import read_contract
from perdure.robots.contract import Contract, Term, make_contract
from perdure.robots.readers import ContractReader
from perdure.robots.terms import ObservationTerm
from perdure.robots.world import VelocityCommandEnv
from perdure.schema import checked
from tests.robots.conftest import ANT

TERMS = ObservationTerm.kinds()


@pytest.fixture(autouse=True)
def forget():
    """Classes are registered as long as they exist."""
    yield
    gc.collect()


@pytest.mark.parametrize("name", TERMS)
def test_every_term_has_words_and_as_many_numbers_as_it_says(name, ant):
    env = VelocityCommandEnv(replace(ant, observations=(Term(name, history=1),)))
    env.reset(seed=0)
    kind = TERMS[name]
    assert kind.words
    assert len(kind().value(env._robot)) == kind.size(ant) == env.observation_space.shape[0]


def test_no_two_terms_share_a_name_or_an_alias():
    names = [*TERMS, *(alias for kind in TERMS.values() for alias in kind.aliases)]
    assert len(set(names)) == len(names)


def test_a_term_is_one_class(ant):
    class BaseHeight(ObservationTerm):
        name = "base_height"
        words = "height of the base [m]"
        components = 1
        aliases = ("torso_height",)

        def value(self, robot):
            return robot.data.qpos[2:3]

    values = {**yaml.safe_load(ANT.read_text()), "observations": [{"name": "torso_height", "scale": 2.0}, "command"]}
    env = VelocityCommandEnv(make_contract(checked({**values, "history": 1}, Contract), ANT.parent))
    observation, _ = env.reset(seed=0)
    assert observation.tolist() == [2.0 * env.data.qpos[2], *env.contract.command]
    assert env.observation_names[0] == "base_height[0]"


@pytest.fixture
def vendor():
    """A reader of a vendor's files: JSON, or YAML that says "vendor", with another name for the gains."""

    class VendorReader(ContractReader):
        name = "vendor"
        words = "files of a vendor"
        suffixes = (".json", ".yaml")

        def recognizes(self, path):
            return path.suffix == ".json" or "vendor" in yaml.safe_load(path.read_text())

        def read(self, path):
            values = yaml.safe_load(path.read_text())  # JSON is YAML
            values["stiffness"] = values.pop("kp")
            values.pop("vendor", None)
            return make_contract(checked(values, Contract), path.parent)

    return VendorReader


def vendors(**changes):
    values = {**yaml.safe_load(ANT.read_text()), **changes}
    return {**values, "kp": values.pop("stiffness")}


def test_a_format_is_one_class(vendor, tmp_path, ant):
    path = tmp_path / "deploy.json"
    path.write_text(json.dumps(vendors(model=str(ant.model))))
    assert read_contract(path) == ant
    assert task_of_environment(str(path)) == str(path)
    assert task_spec(str(path)).observation_size == ant.observation_size


def test_a_format_is_recognized_by_its_contents(vendor, tmp_path, ant):
    theirs, ours = tmp_path / "deploy.yaml", tmp_path / "ours.yaml"
    theirs.write_text(yaml.safe_dump({**vendors(model=str(ant.model)), "vendor": 1}))
    ours.write_text(yaml.safe_dump({**yaml.safe_load(ANT.read_text()), "model": str(ant.model)}))
    assert read_contract(theirs) == read_contract(ours) == ant


def test_an_error_of_a_reader_names_the_file(vendor, tmp_path):
    path = tmp_path / "deploy.json"
    path.write_text(json.dumps(vendors(damping=[1.0])))
    with pytest.raises(PerdureError, match=r"deploy\.json: damping has 1 values for 8 joints"):
        read_contract(path)
    assert np.size(read_contract(ANT).values("stiffness")) == 8


def test_without_its_reader_a_file_is_no_task(tmp_path):
    with pytest.raises(PerdureError, match="no task"):
        task_of_environment(str(tmp_path / "deploy.toml"))
