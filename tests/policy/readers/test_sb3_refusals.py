"""What is refused, each in one line and without running anything."""

from __future__ import annotations

import base64
import io
import pickle
import struct
import zipfile

import numpy as np
import pytest
from altered import FIXTURES, Payload, model, payload, rebuilt, with_settings, with_state

from perdure.errors import PerdureError
from perdure.policy import Policy, load_policy
from perdure.policy.readers.sb3_import import read_vecnormalize

BOX = "<class 'gymnasium.spaces.box.Box'>"


def read(data, folder, env="Pendulum-v1", **options):
    path = folder / "model.zip"
    path.write_bytes(data)
    options.setdefault("normalizer", "none")
    return Policy.from_sb3(path, env, measure=False, **options)


def refused(data, folder, pattern, kind=PerdureError, **options):
    with pytest.raises(kind, match=pattern) as caught:
        read(data, folder, **options)
    message = str(caught.value)
    assert message.startswith(str(folder / "model.zip"))
    assert "\n" not in message
    assert len(message) < 400


def nan_weights(contents):
    """A storage whose first number is not a number."""
    return struct.pack("<f", float("nan")) + contents[4:]


BOMB = 70_000_000
"""Bytes of zeros, more than settings may have; packed they take 70,000."""


def bomb():
    return rebuilt(model(), {"data": bytes(BOMB)}, zipfile.ZIP_DEFLATED)


def declaring(data, true_size, declared):
    """An archive with a member that declares another size."""
    old, new = (size.to_bytes(4, "little") for size in (true_size, declared))
    assert old in data
    return data.replace(old, new)


def weights_bomb():
    with zipfile.ZipFile(FIXTURES / "ppo.zip") as archive:
        return declaring(model(), archive.getinfo("policy.pth").file_size, 600_000_000)


def many_members():
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for number in range(10_001):
            archive.writestr(str(number), b"")
    return written.getvalue()


DAMAGED = {
    "empty": (lambda: b"", "not a zip archive"),
    "text": (lambda: b"a shopping list\n", "not a zip archive"),
    "truncated": (lambda: model()[:-500], "its end is missing"),
    "first half": (lambda: model()[: len(model()) // 2], "its end is missing"),
    "bomb in the settings": (bomb, "'data' unpacks to 70,000,000 bytes"),
    "bomb in the weights": (weights_bomb, "'policy.pth' unpacks to 600,000,000"),
    "bomb that declares a small size": (lambda: declaring(bomb(), BOMB, 1000), "'data' is damaged"),
    "many members": (many_members, "more than 10,000 members"),
    "no settings": (lambda: rebuilt(model(), {"data": None}), "no member 'data'"),
    "no weights": (lambda: rebuilt(model(), {"policy.pth": None}), "no member 'policy.pth'"),
    "settings that are no JSON": (lambda: rebuilt(model(), {"data": b"{"}), "not readable JSON"),
    "nested JSON": (lambda: rebuilt(model(), {"data": b"[" * 1_000_000}), "not readable JSON"),
    "nested table": (lambda: rebuilt(model(), {"data": b'{"a":' * 200_000}), "not readable JSON"),
    "a list of settings": (lambda: rebuilt(model(), {"data": b"[]"}), "not a table"),
    "weights that are no archive": (lambda: rebuilt(model(), {"policy.pth": b"\x80\x02x."}), "before 1.6.*--trust"),
    "weights cut off": (lambda: rebuilt(model(), {"policy.pth": lambda old: old[:-300]}), "policy.pth.*end is missing"),
    "a storage cut off": (lambda: with_state({"data/3": lambda old: old[:-4]}), "is not a tensor"),
    "a storage missing": (lambda: with_state({"data/3": None}), "has no member 'archive/data/3'"),
    "not a number": (lambda: with_state({"data/3": nan_weights}), "not finite"),
    "big-endian": (lambda: with_state({"byteorder": b"big"}), "big-endian"),
    "no state dict": (lambda: with_state({"data.pkl": pickle.dumps([1, 2], 2)}), "not a state dict"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_damaged_files_are_refused(case, tmp_path):
    make, pattern = DAMAGED[case]
    refused(make(), tmp_path, pattern)


def test_the_builder_of_these_tests_keeps_a_model_readable(tmp_path):
    """The control: what is refused above is refused for what was changed."""
    rows = np.random.default_rng(0).normal(size=(5, 3))
    expected = read(model(), tmp_path).act(rows, np.zeros(5))
    packed = rebuilt(model(), {"policy.pth": lambda old: rebuilt(old, {})}, zipfile.ZIP_DEFLATED)
    np.testing.assert_array_equal(read(packed, tmp_path).act(rows, np.zeros(5)), expected)


def space(kind, **values):
    return {":type:": f"<class 'gymnasium.spaces.x.{kind}'>", **values}


OTHER_KINDS = {
    "image observations": (
        lambda s: s.update(observation_space={":type:": BOX, "dtype": "uint8", "_shape": [84, 84, 3]}),
        "image observations",
    ),
    "graphs as observations": (lambda s: s.update(observation_space=space("Graph")), "Graph observations"),
    "bits as actions": (lambda s: s.update(action_space=space("MultiBinary", n="4")), "MultiBinary actions"),
    "recurrent": (
        lambda s: s["policy_class"].update(__module__="sb3_contrib.common.recurrent.policies"),
        "recurrent=True",
    ),
    "CrossQ": (lambda s: s["policy_class"].update(__module__="sb3_contrib.crossq.policies"), "crossq"),
    "a list as policy class": (lambda s: s["policy_class"].update(__module__=["x"]), "comes from a list"),
    "own policy class": (lambda s: s["policy_class"].update(__module__="__main__"), "__main__"),
    "own features": (lambda s: s["policy_kwargs"].update(features_extractor_class="<class 'x.Mine'>"), "features_extr"),
    "own setting": (lambda s: s["policy_kwargs"].update(depth=3), "depth"),
    "own activation": (lambda s: s["policy_kwargs"].update(activation_fn="<class '__main__.Sine'>"), "Sine"),
    "no spaces": (lambda s: s.pop("observation_space"), "unknown observations"),
    "spaces of another type": (lambda s: s.update(observation_space=7), "unknown observations"),
}


@pytest.mark.parametrize("case", OTHER_KINDS)
def test_policies_of_other_kinds_are_sent_to_the_door_for_functions(case, tmp_path):
    change, pattern = OTHER_KINDS[case]
    refused(with_settings(change), tmp_path, rf"{pattern}.*perdure\.extrapolate\(function, env")


@pytest.mark.parametrize("number", ["", "0", "-1", "1e9", "x", None, {"a": 1}], ids=str)
def test_a_number_of_choices_that_is_none_is_refused(number, tmp_path):
    data = with_settings(lambda s: s.update(action_space=space("Discrete", n=number)), "dqn")
    refused(data, tmp_path, "how many discrete actions", env="Acrobot-v1")


def test_quantiles_that_do_not_fit_the_choices_are_refused(tmp_path):
    data = with_settings(lambda s: s.update(action_space=space("Discrete", n="4")), "qrdqn")
    refused(data, tmp_path, "15 quantiles of 4 actions", env="Acrobot-v1")


def test_a_network_with_other_parts_is_refused(tmp_path):
    """A module of another policy class: its weights have other names."""
    data = with_settings(lambda s: s["policy_class"].update(__module__="stable_baselines3.sac.policies"))
    refused(data, tmp_path, "not a plain perceptron.*perdure.extrapolate")


@pytest.mark.parametrize("value", [-1, "0.99", None, True, float("nan"), 1e300], ids=str)
def test_a_gamma_that_is_none_is_refused(value, tmp_path):
    refused(with_settings(lambda s: s.update(gamma=value)), tmp_path, "gamma must be a number")


@pytest.mark.parametrize(
    "extractor",
    [
        "<class 'mine.ScaledFlattenExtractor'>",
        "<class 'mine.FlattenExtractor'>",
        ["FlattenExtractor"],
    ],
    ids=str,
)
def test_a_features_extractor_that_is_not_flattening_is_refused(extractor, tmp_path):
    def change(settings):
        settings["policy_kwargs"]["features_extractor_class"] = extractor

    refused(with_settings(change), tmp_path, "the setting features_extractor_class, which is not read")


def test_the_flattening_extractor_is_read_where_it_is_named(tmp_path):
    def change(settings):
        name = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"
        settings["policy_kwargs"]["features_extractor_class"] = name

    read(with_settings(change), tmp_path)


class TestWhatDoesNotFitTheEnvironment:
    def test_observations(self, tmp_path):
        refused(model(), tmp_path, r"takes 3 numbers, but gymnasium:Hopper-v5 gives 11", PerdureError, env="Hopper-v5")

    def test_observations_that_lack_the_time_feature(self, tmp_path):
        refused(model("sac-time"), tmp_path, r"takes 4 .* gives 3 .*add --time-feature linear\)", PerdureError)

    def test_a_time_feature_too_many(self, tmp_path):
        refused(model(), tmp_path, r"takes 3 .* gives 4 with the time feature", PerdureError, time_feature="linear:200")

    def test_actions(self, tmp_path):
        def narrow(settings):
            settings["action_space"]["high"] = "[1.]"

        refused(with_settings(narrow), tmp_path, r"upper bounds \[1.0\].*\[2.0\].*rescales", PerdureError)

    def test_a_normalizer_for_other_observations(self, tmp_path):
        statistics = FIXTURES / "ppo-time.pkl"
        refused(model(), tmp_path, "statistics of 4 numbers.*given 3", PerdureError, normalizer=statistics)

    def test_a_normalizer_that_was_forgotten(self, tmp_path):
        refused(model(), tmp_path, "trained behind VecNormalize.*--normalizer", PerdureError, normalizer=None)
        read(model("trpo"), tmp_path, normalizer=None)  # was trained without one

    @pytest.mark.parametrize("text", ["1000", "linear:", "linear:0", "linear:-5", "linear:1e3", "geometric:10"])
    def test_a_time_feature_that_is_none(self, text, tmp_path):
        with pytest.raises(PerdureError, match=r"linear:1000, got"):
            read(model("sac-time"), tmp_path, time_feature=text)


class TestPayload:
    """A pickle that would create a file."""

    @pytest.fixture
    def trace(self, tmp_path):
        return tmp_path / "trace"

    @pytest.mark.parametrize("protocol", range(2, 6))
    def test_it_works_where_pickles_are_run(self, trace, protocol):
        pickle.loads(payload(trace, protocol)).close()
        assert trace.exists()

    @pytest.mark.parametrize("protocol", range(2, 6))
    def test_in_the_weights_is_refused(self, trace, tmp_path, protocol):
        data = with_state({"data.pkl": payload(trace, protocol)})
        refused(data, tmp_path, r"policy.pth asks for the Python object '_?io.open', which was not run.*--trust")
        assert not trace.exists()

    def test_instead_of_the_weights_is_refused(self, trace, tmp_path):
        refused(rebuilt(model(), {"policy.pth": payload(trace)}), tmp_path, "not a zip archive.*--trust")
        assert not trace.exists()

    def test_in_the_settings_is_not_decoded(self, trace, tmp_path):
        code = base64.b64encode(payload(trace, 4)).decode()

        def plant(settings):
            for value in settings.values():
                if isinstance(value, dict) and ":serialized:" in value:
                    value[":serialized:"] = code

        read(with_settings(plant), tmp_path)
        assert not trace.exists()

    @pytest.mark.parametrize("protocol", range(2, 6))
    def test_in_the_statistics_is_refused(self, trace, tmp_path, protocol):
        path = tmp_path / "vecnormalize.pkl"
        path.write_bytes(payload(trace, protocol))
        with pytest.raises(PerdureError, match=r"'_?io.open'"):
            read_vecnormalize(path)
        path.write_bytes(pickle.dumps({"obs_rms": [Payload(trace)]}, protocol))
        with pytest.raises(PerdureError, match="object"):
            read(model(), tmp_path, normalizer=path)
        assert not trace.exists()


VEC = b"\x80\x04cstable_baselines3.common.vec_env.vec_normalize\nVecNormalize\n)\x81}(X\x05\x00\x00\x00gamma%sub."
"""A pickle of a VecNormalize whose discount is %s."""
LONG = b"\x8a\xff" + b"\x7f" * 255
"""A whole number of 255 bytes."""
F8 = b"cnumpy\ndtype\n%sR"
SCALAR_OF = b"cnumpy.core.multiarray\nscalar\n(%sC\x08" + bytes(8) + b"tR"
ARRAY_OF = b"cnumpy.core.numeric\n_frombuffer\n(C\x10%s" + F8 % b"X\x02\x00\x00\x00f8\x85" + b"%sX\x01\x00\x00\x00CtR"
NOT_NUMBERS = {
    "a huge number": LONG,
    "a dtype without a name": SCALAR_OF % (F8 % b")"),
    "a dtype with an empty state": SCALAR_OF % (F8 % b"X\x02\x00\x00\x00f8\x85" + b")b"),
    "a dtype with a table as its state": SCALAR_OF % (F8 % b"X\x02\x00\x00\x00f8\x85" + b"}b"),
    "two numbers": ARRAY_OF % (np.array([0.9, 0.9]).tobytes(), b"K\x02\x85"),
    "a shape of 5,000 numbers": ARRAY_OF % (bytes(16), b"(" + LONG * 5_000 + b"t"),
}


@pytest.mark.parametrize("number", NOT_NUMBERS)
def test_statistics_that_are_no_numbers_are_refused(number, tmp_path):
    path = tmp_path / "statistics.pkl"
    path.write_bytes(VEC % NOT_NUMBERS[number])
    with pytest.raises(PerdureError, match=r"statistics\.pkl: gamma (is not an array of real|must be one) number"):
        read_vecnormalize(path)


def test_a_damaged_member_packed_with_lzma_is_refused(tmp_path):
    data = bytearray(rebuilt(model(), {}, zipfile.ZIP_LZMA))
    name, extra = struct.unpack("<HH", data[26:30])
    data[30 + name + extra + 9] = 0xFF  # the first byte of the range coder must be 0
    refused(bytes(data), tmp_path, "is damaged")


def test_statistics_of_old_libraries_with_their_random_generator_are_read(tmp_path):
    from perdure.policy.readers.restricted_pickle import read_pickle
    from perdure.policy.readers.sb3_import import ALLOWED

    spaces = pickle.dumps({"np_random": np.random.RandomState(0)})  # as gym 0.21 kept it in a space
    assert "np_random" in read_pickle(spaces, ALLOWED, "old")


def test_a_zip_where_a_policy_file_is_expected_is_named(tmp_path):
    path = tmp_path / "model.zip"
    path.write_bytes(model())
    with pytest.raises(PerdureError, match=r"Stable-Baselines3.*--env.*from_sb3"):
        load_policy(path)
