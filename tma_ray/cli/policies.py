"""Commands `export`, `render` and `play`."""

from typing import Annotated

from tma_ray.cli.common_options import Count, Licence, NewFile, Output, Policy, RunResults, Seed
from tma_ray.console.command_line import command, value, values
from tma_ray.console.types import named

EnvironmentName = Annotated[str, value(named("the name of an environment"), "NAME")]
BodyName = Annotated[str, value(named("the name of a body"), "NAME")]


@command()
def export(
    policy: Policy,
    /,
    *,
    output: Output,
    results: RunResults = "results",
    licence: Licence | None = None,
    no_onnx: bool = False,
    playground: bool = False,
) -> int:
    """Export a policy as safetensors and ONNX, with a model card.

    Args:
        policy: ID of a run or its beginning, or the folder of a saved policy
        output: new or empty folder to write to
        licence: licence of the policy, as CC-BY-4.0 (default: none)
        no_onnx: leave the ONNX file out
        playground: add a page that plays the policy in a browser
    """
    from tma_ray.export import export as write

    done = write(str(policy), output, results, licence or "", not no_onnx, playground)
    if done.difference is not None:
        print(f"{done.folder}: actions of the ONNX file differ by at most {done.difference:.2g}")
    else:
        print(f"{done.folder}: without an ONNX file")
    return 0


@command()
def render(
    *,
    output: NewFile,
    task: Annotated[str | None, value(named("a task"), "TASK")] = None,
    environment: EnvironmentName | None = None,
    embodiment: BodyName | None = None,
    policy: Policy = "random",
    results: RunResults = "results",
    seed: Seed = 0,
    steps: Count = 1000,
    every: Count = 2,
) -> int:
    """Render an episode as a video or a picture.

    It is of a saved policy, of random actions or of none.

    Args:
        output: video (.mp4, .gif) or picture (.png)
        task: values as 0.5,3, pairs as stump_height=0.5,obstacle_spacing=3, or random (default: the middle of
            the task space)
        environment: environment (default: the run's, else stump_tracks)
        embodiment: body (default: the run's, else classic_bipedal)
        policy: a run, the folder of a saved policy, random (uniform actions) or zero (none)
        seed: seed of worlds, random tasks and random actions
        steps: steps after which an episode is left
        every: steps from one frame to the next
    """
    from tma_ray.viewing.rendering import EpisodeSettings
    from tma_ray.viewing.rendering import render as draw

    settings = EpisodeSettings(str(policy), results, environment, embodiment, seed, steps, every, task)
    episode = draw(settings, output)
    success = "mastered" if episode.success else "not mastered"
    end = f"ended after {episode.steps}" if episode.ended else f"left after {episode.steps}"
    print(f"{output}: {end} steps, return {episode.episodic_return:.1f}, {success}")
    return 0


@command()
def play(
    *,
    environment: EnvironmentName | None = None,
    embodiment: BodyName | None = None,
    policy: Annotated[tuple[str, ...], values(named("a policy"), "POLICY")] = ("random",),
    results: RunResults = "results",
    task: Annotated[str | None, value(named("a task"), "TASK")] = None,
    seed: Seed = 0,
    output: NewFile | None = None,
) -> int:
    """Play policies in the browser, on tasks of your choice.

    Writes a page and opens it. There, tasks are chosen on their plane, ground is drawn by hand, and bodies
    are pushed. The page needs no network.

    Args:
        environment: environment (default: the run's, else stump_tracks)
        embodiment: body (default: the run's, else classic_bipedal)
        policy: a run, the folder of a saved policy, random (uniform actions) or zero (none); repeatable, for
            up to four at once (default: random)
        task: values as 0.5,3, pairs as stump_height=0.5,obstacle_spacing=3, or random (default: the middle of
            the task space)
        seed: seed of the page's worlds and of random tasks
        output: page (.html) to write instead of opening one (default: none)
    """
    from tma_ray.viewing.play import PlaySettings
    from tma_ray.viewing.play import play as open_page

    if output is not None and output.suffix != ".html":
        raise ValueError(f"{output}: expected a file that ends in .html")
    print(open_page(PlaySettings(policy, results, environment, embodiment, task, seed), output))
    return 0
