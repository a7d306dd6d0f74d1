"""The look of pictures and film: plain validated data, light to import.

What is left out is chosen from the scene: the camera frames the action, sizes follow the spacing
of the points, colours and light come with the background.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from typing_extensions import Self

from tianim.params import Animated, Fraction, Number, Params, Positive, Vector3
from tianim.view.material import MaterialField

MAX_SIDE = 7680  # pixels: 8K film
MAX_TRAIL = 200  # frames; each is kept in memory while the film is drawn
MAX_FILM = 100_000  # frames

Side = Annotated[int, Field(ge=16, le=MAX_SIDE, multiple_of=2)]
Elevation = Annotated[float, Field(ge=-89, le=89)]
Color = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Preset = Literal["dusk", "night", "space", "studio", "water", "paper"]
ColorMap = Literal[
    "viridis", "magma", "inferno", "plasma", "cividis", "twilight", "turbo", "phase", "starlight", "water"
]
PartKind = Literal[
    "auto",
    "spheres",
    "darts",
    "birds",
    "fish",
    "bees",
    "arrows",
    "glow",
    "foam",
    "stars",
    "lines",
    "mesh",
    "hidden",
]


def _rising(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError(f"the first must be less than the second: {value[0]:g} >= {value[1]:g}")
    return value


NumberRange = Annotated[tuple[Number, Number], AfterValidator(_rising)]


class ColorBy(Params):
    """What the colour of a part says.

    `color: speed` is short for `color: {by: speed}` and `color: "#336699"` for one colour.
    """

    by: str | None = Field(
        default=None,
        max_length=64,
        description="data name of the part, 'speed', 'heading', 'height' or one colour '#rrggbb'; "
        "left out: what suits the background",
    )
    map: ColorMap | None = Field(
        default=None, description="colour map; left out: viridis, and phase (cyclic) for 'heading'"
    )
    range: NumberRange | None = Field(
        default=None,
        description="values at the two ends of the map [unit of the data]; "
        "left out: 2 to 98 % of the whole film",
    )
    log: bool = Field(default=False, description="map the logarithm of the value")
    palette: tuple[Color, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="one colour for each whole number of the data, in order; replaces the map",
    )
    back: Color | None = Field(
        default=None, description="colour of the back of a mesh; left out: as the front"
    )

    @model_validator(mode="after")
    def _uniform_is_a_color(self) -> Self:
        if self.by is not None and self.by.startswith("#") and not _is_hex(self.by):
            raise ValueError(f"by: {self.by!r} is not a colour; write '#rrggbb'")
        return self


def _is_hex(text: str) -> bool:
    return len(text) == 7 and all(c in "0123456789abcdefABCDEF" for c in text[1:])


def _short_color(value: Any) -> Any:
    return {"by": value} if isinstance(value, str) else value


class PartStyle(Params):
    """How one part of a frame is drawn."""

    kind: PartKind = Field(
        default="auto",
        description="what stands for an item; auto: darts for points that move (arrows in 2D), "
        "spheres for points that do not and for the particles of a fluid, lines and meshes as they are; "
        "foam: small soft white discs; stars: light that adds up behind all "
        "else, as a telescope shows it, by the mass of each point",
    )
    size: Positive | None = Field(
        default=None,
        description="length of a dart, diameter of a sphere, thickness of a line [m]; "
        "left out: from the spacing of the points and the view; a part of under 2 % of all points is "
        "drawn 3 times as large as the others",
    )
    color: Annotated[ColorBy, BeforeValidator(_short_color, json_schema_input_type=str | ColorBy)] = Field(
        default=ColorBy(), description="what the colour says"
    )
    beads: Positive | None = Field(
        default=None,
        description="diameter of balls at the points of lines: the masses of springs [m]; left out: none",
    )
    trail: Annotated[int, Field(ge=0, le=MAX_TRAIL)] = Field(
        default=0, description="length of the trail behind each point, or each bead [frames]"
    )
    opacity: Annotated[float, Field(gt=0, le=1)] = Field(
        default=1.0,
        description="1 hides what is behind; less lets it through (points and lines); a factor on the light "
        "of stars",
    )
    material: MaterialField | None = Field(
        default=None,
        description="what a closed mesh is made of that light goes through: water, glass, honey, lava; "
        "left out: it is matt",
    )
    framed: bool = Field(
        default=True, description="whether the camera keeps the part in the picture; what is hidden is not"
    )


class CameraLook(Params):
    """Where the picture is taken from. Left out, the camera frames the action and follows it smoothly."""

    position: Animated[Vector3] | None = Field(
        default=None, description="place of the camera [m]; left out: chosen"
    )
    target: Animated[Vector3] | None = Field(
        default=None, description="point in the centre of the picture [m]; left out: the action"
    )
    projection: Literal["auto", "perspective", "orthographic"] = Field(
        default="auto", description="auto: orthographic for flat scenes, else perspective"
    )
    field_of_view: Annotated[float, Field(ge=2, le=120)] = Field(
        default=35.0, description="vertical angle of view [degrees]"
    )
    azimuth: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        default=None, description="direction the camera stands in, from z towards x [degrees]"
    )
    elevation: Animated[Elevation] | None = Field(
        default=None, description="height of the camera above the action [degrees]; negative looks up"
    )
    orbit: Annotated[float, Field(ge=-3600, le=3600)] = Field(
        default=20.0, description="angle the camera goes round during the film [degrees]"
    )
    fill: Annotated[float, Field(ge=0.05, le=2)] | None = Field(
        default=None,
        description="share of the height of the picture that the action fills; "
        "left out: 0.62, and 0.86 for a flat scene",
    )

    @model_validator(mode="after")
    def _not_at_its_target(self) -> Self:
        if self.position is not None and self.position == self.target:
            raise ValueError(f"position and target are the same point {self.position}")
        return self


class Look(Params):
    """The `view` of a scene: picture, camera, background, and the style of each part by name."""

    width: Side = Field(default=1280, description="width of the pictures [pixels], even")
    height: Side = Field(default=720, description="height of the pictures [pixels], even")
    samples: Literal[1, 2, 3] | None = Field(
        default=None,
        description="samples along each side of a pixel: 1 is fast and rough, 3 slow and smooth; "
        "left out: 2, and 1 from 400,000 points on",
    )
    renderer: Literal["auto", "splat", "open3d"] = Field(
        default="auto",
        description="splat needs nothing but the CPU; open3d draws meshes where its Vulkan works; "
        "auto: splat",
    )
    camera: CameraLook = Field(default=CameraLook(), description="where the picture is taken from")
    background: Preset | Literal["auto"] | tuple[Color, Color] = Field(
        default="auto",
        description="dusk, night, space, studio, water, paper, or two colours from bottom to top; auto: "
        "space for stars, studio for fluids and meshes, night for flat fluids, paper for other flat scenes, "
        "dusk for the rest",
    )
    parts: dict[Annotated[str, Field(min_length=1, max_length=64)], PartStyle] = Field(
        default={}, description="style of each part, by its name"
    )
    fog: Fraction | None = Field(
        default=None,
        description="how far the back of the action fades into the background, 0 to 1; "
        "left out: what suits the background",
    )
    floor: bool | None = Field(
        default=None,
        description="a floor under the action, lit round it where the background is dark; left out: what "
        "suits the background, and under a fluid in the dark",
    )
    shadows: bool | None = Field(
        default=None, description="cast shadows and shade corners; left out: what suits the background"
    )
    exposure: Positive = Field(default=1.0, description="factor on the light")
    film_frames: Annotated[int, Field(ge=1, le=MAX_FILM)] = Field(
        default=600,
        description="most frames of the film; a longer run is shown every second, third ... frame",
    )
    preview_at: Fraction = Field(
        default=0.6, description="moment that preview.png shows, as a share of the film: 0 its first picture"
    )
    sheet: Annotated[int, Field(ge=1, le=64)] = Field(
        default=8, description="number of poses in the contact sheet"
    )
