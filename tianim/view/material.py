"""Materials that light goes through: water, glass, honey, lava; plain validated data, light to import.

Light that goes a way t [m] through a material keeps exp(-sigma t) of itself (Beer and Lambert), of each
colour its own share; part of what it loses comes back as the colour of the body itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from tianim.params import Fraction, NonNegative, Params, Positive
from tianim.view.colormap import hex_to_linear

Float = NDArray[np.float32]

MaterialName = Literal["water", "glass", "honey", "lava"]
Tint = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
RefractiveIndex = Annotated[float, Field(ge=1.0, le=3.0)]

DARKEST = 0.004  # share of a colour that is left where a tint has none of it: sigma stays finite
DEEP = 1.3  # exponent of the tint in the colour of the body
HOT = 0.8  # exponent of the tint in the light of its own: the hotter, the paler
IN_THE_DARK = 1.8  # factor on the cloudiness of a material left to itself
THICK = 2.5  # a material left to itself has its tint at 1 / (THICK x radius of the action)


class Material(Params):
    """What a closed mesh is made of.

    `material: water` is short for `material: {like: water}`.
    """

    like: MaterialName = Field(default="water", description="what is taken where the rest is left out")
    tint: Tint | None = Field(
        default=None,
        description="colour of white light after a way of 1 / absorption; left out: as the material",
    )
    absorption: Positive | None = Field(
        default=None,
        description="how fast light takes the tint [1/m]; left out: from the size of the action, so that "
        "a model in a bowl and a sea look alike",
    )
    cloudiness: Fraction | None = Field(
        default=None,
        description="share of the absorbed light that comes back as the colour of the body: "
        "0 clear, 1 milky; left out: as the material",
    )
    refraction: RefractiveIndex | None = Field(
        default=None, description="refractive index, 1 (as air) to 3; left out: as the material"
    )
    roughness: Fraction | None = Field(
        default=None, description="0 mirrors sharply, 1 not at all; left out: as the material"
    )
    emission: NonNegative | None = Field(
        default=None,
        description="light of its own, in units of the key light; left out: as the material",
    )


@dataclass(frozen=True)
class Kind:
    """A material with nothing left open but its scale; `thick` is a factor on THICK."""

    tint: str
    cloudiness: float
    refraction: float
    roughness: float
    emission: float
    thick: float


KINDS: dict[str, Kind] = {
    "water": Kind("#3a9fd0", 0.28, 1.33, 0.03, 0.0, 1.25),
    "glass": Kind("#cfe8e2", 0.0, 1.5, 0.02, 0.0, 0.6),
    "honey": Kind("#e8970c", 0.35, 1.49, 0.08, 0.0, 2.4),
    "lava": Kind("#f0480c", 0.30, 1.6, 0.6, 1.3, 40.0),
}


@dataclass(frozen=True)
class Substance:
    """A material in numbers: sigma (3,) [1/m], body and glow (3,) linear light, the rest as in `Material`."""

    sigma: Float
    body: Float
    glow: Float
    refraction: float
    roughness: float
    emission: float

    @property
    def row(self) -> Float:
        """What the kernels read: sigma 0:3, body 3:6, glow 6:9, refraction, roughness, emission."""
        rest = [self.refraction, self.roughness, self.emission]
        return np.concatenate([self.sigma, self.body, self.glow, rest]).astype(np.float32)


def tint_of(material: Material) -> str:
    """Its tint, '#rrggbb'."""
    return material.tint or KINDS[material.like].tint


def substance(material: Material, radius: float, dark: bool = False) -> Substance:
    """The numbers of `material` in a film whose action has this radius [m], before a `dark` background."""
    kind = KINDS[material.like]
    color = hex_to_linear(tint_of(material))
    absorption = material.absorption or THICK * kind.thick / max(radius, 1e-12)
    cloudiness = material.cloudiness
    if cloudiness is None:  # in the dark nothing shines through: the body must be seen by its own colour
        cloudiness = kind.cloudiness * (IN_THE_DARK if dark else 1.0)
    return Substance(
        sigma=(-np.log(np.maximum(color, DARKEST)) * absorption).astype(np.float32),
        body=(color**DEEP * cloudiness).astype(np.float32),
        glow=np.power(color, HOT).astype(np.float32),
        refraction=material.refraction or kind.refraction,
        roughness=kind.roughness if material.roughness is None else material.roughness,
        emission=kind.emission if material.emission is None else material.emission,
    )


def short_material(value: Any) -> Any:
    """`water` for `{like: water}`."""
    return {"like": value} if isinstance(value, str) else value


MaterialField = Annotated[
    Material, BeforeValidator(short_material, json_schema_input_type=MaterialName | Material)
]
