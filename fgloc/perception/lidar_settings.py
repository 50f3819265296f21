"""How objects are found in the clouds of a node's LiDAR: numbers with their reasons."""

from pydantic import Field

from fgloc.config import Section


class LidarConfig(Section):
    """Background, clusters and cuboids."""

    voxel_m: float = Field(default=0.3, gt=0.01, le=5)
    """Side of the background's voxels: ten sigmas of a range, less than a lane's margin."""
    learn_frames: int = Field(default=50, ge=2, le=5000)
    """Frames over the whole recording that the background is learnt from beforehand."""
    least_ground_share: float = Field(default=0.05, ge=0, le=1)
    """Of all points, that lie on the ground of the survey; where they are fewer the mount is taken
    for wrong."""
    least_share: float = Field(default=0.3, gt=0, le=1)
    """A voxel with points in this share of these frames is background: more than passing cars fill,
    less than a wall whose points change between two voxels. What stands longer is background."""
    fill_m: float = Field(default=2.0, ge=0)
    """Background above each other with gaps up to this is filled: what lies between two beams."""
    clearance_m: float = Field(default=0.25, ge=0)
    """Points up to so high above the ground are the ground's."""
    most_top_m: float = Field(default=4.5, gt=0)
    """Points higher above the ground are of no road user."""
    lateral_rad: float = Field(default=0.015, gt=0)
    radial_beams: float = Field(default=1.3, gt=0)
    radial_least_m: float = Field(default=0.8, gt=0)
    radial_most_m: float = Field(default=4.6, gt=0)
    """Neighbours are up to so far apart across the line of sight. Along it by so many times what
    two beams are apart on a level surface, within limits: parts of one car are no farther apart
    than its length."""
    core_points: int = Field(default=3, ge=1)
    """Neighbours, itself among them, that let a cluster grow from a point."""
    least_points: int = Field(default=4, ge=3)
    """Of a cluster; smaller ones are left out."""
    least_top_m: float = Field(default=0.6, ge=0)
    """Above the ground: lower clusters are left out."""
    most_length_m: float = Field(default=20.0, gt=0)
    """Longer clusters are left out."""
    person_m: float = Field(default=1.0, gt=0)
    """A cluster that is nowhere longer takes the size of a person, any other at least a car's."""
    shadow_m: float = Field(default=0.6, ge=0)
    """A cluster to which more would have to be added across the line of sight is left out where
    something nearer hides that much beside it: its points do not tell which way it goes on."""
    fragment_m: float = Field(default=1.5, ge=0)
    """So much of a car may be hidden beside what looks like a person."""
