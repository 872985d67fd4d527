"""The camera of the simulated world: pictures of the true scene, with sun, shadow and sensor noise."""

from sim_bridge.render.renderer import Renderer, make_renderer
from sim_bridge.render.sensor import encode_jpeg

__all__ = ["Renderer", "encode_jpeg", "make_renderer"]
