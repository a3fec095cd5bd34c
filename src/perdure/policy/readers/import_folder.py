"""Import a model into a folder once; a later import of the same files finds it there."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from perdure.envs import task_of_environment
from perdure.envs.source import source_digest
from perdure.policy.errors import PolicyFileError
from perdure.policy.files import load_policy, save_policy
from perdure.policy.readers.identity import library_versions
from perdure.policy.readers.sb3_import import NO_NORMALIZER, import_sb3
from perdure.runs import file_digest


def import_once(path: Path, folder: Path, env: str, **options: Any) -> Path:
    """Return the file in `folder` that holds the imported policy; import it only if it is not there yet.

    The file's name contains a digest of the files' contents, the options and the versions that decide the outcome.

    Args:
        path: As in `import_sb3`.
        folder: Made if it is missing.
        env: As in `import_sb3`.
        options: `normalizer`, `time_feature`, `training_horizon` and `trust` of `import_sb3`.
    """
    normalizer = options.get("normalizer")
    identity: dict[str, Any] = {
        **options,
        "env": task_of_environment(env),
        "model": file_digest(path),
        "normalizer": None if normalizer in (None, NO_NORMALIZER) else file_digest(Path(normalizer)),
        "no normalizer": normalizer == NO_NORMALIZER,
        "versions": library_versions(),
    }
    source = source_digest(identity["env"])
    identity |= {"source": source} if source else {}
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    target = folder / f"{path.stem}-{digest[:12]}.safetensors"
    try:
        if target.exists():
            load_policy(target)
            return target
    except PolicyFileError:
        pass  # damaged: it is made again
    policy = import_sb3(path, env, **options)
    folder.mkdir(parents=True, exist_ok=True)
    return save_policy(policy, target)
