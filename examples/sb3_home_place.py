"""A place policy of Stable-Baselines3 in the home protocol: alone, and with the inverse-kinematics hand-over.

    pip install "stable-baselines3>=2.7" ".[home]"
    python examples/sb3_home_place.py --train-steps 2000000 --out logs
    perdure home analyze logs/*.parquet --out page

Learns place in its Gymnasium environment, then lets it act in whole SetTable episodes, beside shipped policies for all
other skills, and prints how often the objects stay. Any library will do: `Predicting` takes a function from
observations to actions.
"""

import argparse
from pathlib import Path

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import perdure.home.skills.gym  # noqa: F401  registers the skills
from perdure.home import load_episodes
from perdure.home.agents.learned import Predicting
from perdure.home.agents.release import make_strategy
from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.files import read_logs, write_logs
from perdure.home.evaluate.page import summary_text
from perdure.home.evaluate.policies import choose_policies, make_agents
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.sim.scene import SceneOptions

TASK = "set_table"
ROLLING = 0.0  # in [m]; as in Habitat: an object that rolls is hardly slowed; 0.0012 is kinder


def learn(steps: int, lanes: int, seed: int) -> tuple[PPO, VecNormalize]:
    """Place, from the benchmark's reward."""

    def make() -> gymnasium.Env:
        return Monitor(gymnasium.make("perdure/HomePlace-v0", task=TASK, rolling=ROLLING))

    env = VecNormalize(DummyVecEnv([make] * lanes), gamma=0.99)
    model = PPO("MlpPolicy", env, n_steps=4096 // lanes, batch_size=512, seed=seed, device="cpu", verbose=1)
    model.learn(steps)
    return model, env


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--train-steps", type=int, default=2_000_000)
    parser.add_argument("--lanes", type=int, default=32)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("logs"))
    args = parser.parse_args()

    args.out.mkdir(parents=True, exist_ok=True)  # before the long part, not after it
    options = ExecutorOptions(eval_seed=0, scene=SceneOptions(rolling=ROLLING))
    episodes = load_episodes(TASK, "val").episodes[: args.episodes]

    model, env = learn(args.train_steps, args.lanes, args.seed)
    place = Predicting(lambda observed: model.predict(env.normalize_obs(observed), deterministic=True)[0])
    for strategy in ("rl", "ik"):
        agents = make_agents(choose_policies(TASK, train_seed=0), "rl")  # the shipped policies
        agents["place"] = make_strategy(strategy, place)
        names = {"place": f"sb3 {strategy}", "train_seed": args.seed}
        executor = Executor(EvaluationProtocol(TASK).skills(), agents, options, **names)
        path = args.out / f"sb3-{strategy}.parquet"
        write_logs(path, list(executor.run(episodes)), {})
        print(f"sb3 {strategy}:\n{summary_text(analyze(read_logs(path)))}")


if __name__ == "__main__":
    main()
