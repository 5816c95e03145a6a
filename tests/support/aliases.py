"""Other spellings of names and types, with which somebody may try to get round a rule."""

from __future__ import annotations

import random
from collections.abc import Iterator

from support.velocities import TWIST, TWIST_STAMPED

KINDS = (TWIST, TWIST_STAMPED)


def aliases(dice: random.Random) -> Iterator[tuple[str, str, bool]]:
    """Spellings of topics and types without an end, and whether exactly that may be published."""
    spoil = (
        lambda name: name.replace("/", "//", 1),
        lambda name: name + "/",
        lambda name: name[1:],
        lambda name: "~" + name,
        lambda name: "rt" + name,
        lambda name: name + " ",
        lambda name: " " + name,
        lambda name: name + "\n",
        lambda name: name + "\0",
        lambda name: name.upper(),
        lambda name: name.replace("c", "\u0441"),
        lambda name: name.replace("e", "\u0435"),
        lambda name: name.replace("_", "\u203f"),
        lambda name: name.replace("cmd", "{ns}"),
        lambda name: name + "_",
        lambda name: name + "/_action/feedback",
        lambda name: "/" + name,
        lambda name: name.replace("/", "/\u200b", 1),
        lambda name: name.replace("cmd_vel", "cmd\u00advel"),
        lambda name: "/_hidden" + name,
        lambda name: name + "/../cmd_vel",
        lambda name: name.replace("cmd", "*"),
    )
    spoil_type = (
        lambda kind: kind.replace("/msg/", "/"),
        lambda kind: kind.replace("/", "."),
        lambda kind: kind + " ",
        lambda kind: kind.lower(),
        lambda kind: kind + "\n",
        lambda kind: kind.replace("Twist", "Wrench"),
        lambda kind: kind.replace("Twist", "*"),
        lambda kind: kind.replace("T", "\u0422"),
    )
    while True:
        levels = [dice.choice(("a", "robot1", "fleet", "x_y")) for _ in range(dice.randrange(4))]
        name, kind, is_right = "/" + "/".join([*levels, "cmd_vel"]), dice.choice(KINDS), True
        for changes, chance in ((spoil, 0.7), (spoil_type, 0.3)):
            if dice.random() < chance:
                is_right = False
                change = dice.choice(changes)
                name, kind = (change(name), kind) if changes is spoil else (name, change(kind))
        yield name, kind, is_right
