"""The damaged input of a number: the same for the same seed, whatever ran before it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from random import Random
from typing import Final

from fuzz.kept import Reproducer, reproducers, seed
from fuzz.mutators import archives, arguments, raw, text, tiff, xml
from fuzz.recipes import OUT, VARIATIONS, Recipe, named

Mutator = Callable[[Random, bytes], tuple[bytes, str]]

KEPT_SHARE: Final = 0.06
"""Share of the inputs that are damaged reproducers of the corpus."""
FIGURES_EVERY: Final = 8
"""Of so many runs one draws the figures of its report, which take most of the time of a run that succeeds."""
PLACES: Final = (
    "fifo",
    "folder",
    "absent",
    "link to itself",
    "link to nothing",
    "link to /dev/zero",
    "socket",
    "empty",
)
"""What may be in the place of a file."""
_BINARY: Final = (".jp2", ".png", ".dat")
_ARCHIVES: Final = (".tar", ".gz", ".zip")
_XML: Final = (".vrt", ".xml")


@dataclass(frozen=True, slots=True)
class Case:
    """A command and the files of the folder that it is run in."""

    name: str
    argv: tuple[str, ...]
    files: Mapping[str, bytes] = field(repr=False)
    """Content by path from the folder."""
    places: Mapping[str, str] = field(default_factory=dict)
    """What is in the place of a file, by path: one of `PLACES`."""
    edits: tuple[str, ...] = ()
    """What was damaged, in words."""
    out_dir: str = OUT
    figures: bool = True
    """Whether the report's figures are drawn."""


def mutator_of(name: str) -> Mutator:
    """Return what damages files of a name."""
    suffix = PurePosixPath(name).suffix.lower()
    if suffix in (".tif", ".tiff"):
        return tiff.damage
    if suffix in _ARCHIVES:
        return archives.damage
    if suffix in _XML:
        return xml.damage
    return raw.damage if suffix in _BINARY else text.damage


def case(
    seed_number: int, number: int, only: Collection[int] | None = None, recipe_part: str | None = None
) -> Case:
    """Return the input of a number.

    Parameters
    ----------
    seed_number : int
        Of the run.
    number : int
        Of the input, from 0.
    only : collection of int, optional
        Apply these of its edits alone, counted from 0; to find the one that matters.
    recipe_part : str, optional
        Of all recipes only those that have this regular expression in their name, and no kept inputs.
    """
    random = Random(f"{seed_number}/{number}")
    kept = reproducers()
    if recipe_part is None and kept and random.random() < KEPT_SHARE:
        made = whole(random.choice(kept))
        victims = tuple(name for name in made.files if name not in ("ref.tif", "s_strip.tif"))
    else:
        recipes = named(recipe_part)
        recipe = random.choices(recipes, [each.weight for each in recipes])[0]
        made, victims = _of_recipe(recipe, random), recipe.victims
    made = replace(made, name=f"{seed_number}/{number} {made.name}", figures=number % FIGURES_EVERY == 0)
    count = random.choices((1, 2, 3, 5), (70, 15, 10, 5))[0]
    for index in range(count):
        if only is None or index in only:
            made = _edited(Random(f"{seed_number}/{number}/{index}"), made, victims)
    return made


def whole(reproducer: Reproducer) -> Case:
    """Return a kept input as it is."""
    return Case(
        reproducer.name, reproducer.argv, reproducer.files, reproducer.places, out_dir=reproducer.out_dir
    )


def _of_recipe(recipe: Recipe, random: Random) -> Case:
    argv = recipe.argv
    files = {name: seed(name) for name in (*recipe.victims, *recipe.others)}
    if recipe.command[0] == "register" and random.random() < 0.25:
        argv += random.choice(VARIATIONS)
    if random.random() < 0.03:
        argv = tuple("json" if each == "none" else each for each in argv)
    return Case(recipe.name, argv, files, out_dir=recipe.out_dir)


def _edited(random: Random, made: Case, victims: tuple[str, ...]) -> Case:
    """Damage one of the files, or the arguments where there is no file to damage."""
    left = [name for name in victims if name in made.files]
    if not left or random.random() < 0.02:
        argv, did = arguments.damage(random, made.argv)
        return replace(made, argv=argv, edits=(*made.edits, f"argv: {did}"))
    name = random.choice(left)
    if random.random() < 0.012:
        place = random.choice(PLACES)
        files = {each: content for each, content in made.files.items() if each != name}
        places = {**made.places, name: place}
        return replace(made, files=files, places=places, edits=(*made.edits, f"{name}: {place}"))
    data, did = damaged(random, mutator_of(name), made.files[name])
    return replace(made, files={**made.files, name: data}, edits=(*made.edits, f"{name}: {did}"))


def damaged(random: Random, mutator: Mutator, data: bytes) -> tuple[bytes, str]:
    """Return damaged content that is not what it was."""
    for _ in range(5):
        made, did = mutator(random, data)
        if made != data:
            return made, did
    return data + b"\0", "a byte added to the end"
