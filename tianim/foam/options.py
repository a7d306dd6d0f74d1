"""What decides where foam comes from and how long it lasts."""

from pydantic import Field

from tianim.params import Count, Fraction, NonNegative, Params, Positive, Range


class FoamOptions(Params):
    """Foam, spray and bubbles: thresholds are [from, to]: none below the first, full from the second on."""

    trapped_air: Range = Field(
        (0.6, 2.4), description="mean speed at which neighbours close in on each other [m/s]"
    )
    wave_crest: Range = Field((0.25, 1.0), description="how convex the surface is where it moves outwards")
    speed: Range = Field((1.0, 4.0), description="speed of the fluid, as its kinetic energy [m/s]")
    trapped_air_rate: NonNegative = Field(
        400.0, description="most particles of foam that trapped air makes of a particle of fluid [1/s]"
    )
    wave_crest_rate: NonNegative = Field(
        400.0, description="most particles of foam that a crest makes of a particle of fluid [1/s]"
    )
    spread: NonNegative = Field(0.1, description="sideways speed of new foam, as a share of the fluid's")
    lifetime: Range = Field(
        (1.0, 4.0), description="of foam: where it hardly came about, where it had to [s]"
    )
    spray_below: Fraction = Field(
        0.2, description="share of a full neighbourhood of fluid below which foam is spray"
    )
    bubble_above: Fraction = Field(
        0.6, description="share of a full neighbourhood of fluid above which foam is a bubble"
    )
    rise: NonNegative = Field(0.25, description="speed at which bubbles rise through fluid at rest [m/s]")
    drag: NonNegative = Field(20.0, description="rate at which bubbles take on the fluid's speed [1/s]")
    oldest_spray: Positive = Field(10.0, description="age at which spray that never landed goes [s]")
    support: float = Field(2.0, ge=1.5, le=4, description="reach of neighbours [particle spacings]")
    most: Count = Field(500_000, description="particles at a time; no more come about beyond")
    most_substeps: int = Field(
        8, ge=1, le=64, description="steps between two frames; fewer where nothing crosses a neighbourhood"
    )
