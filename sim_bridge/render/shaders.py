"""GLSL of the EGL backend. Constants that the ray caster shares come from light.py."""

from __future__ import annotations

from sim_bridge.render import light

SURFACE_VERTEX = """
#version 330 core
in vec3 in_position; in vec2 in_uv; in vec4 in_color;
uniform mat4 clip_from_enu;
uniform vec3 eye_enu_m;
out vec3 enu_m; out vec3 from_eye_m; out vec2 uv; flat out vec4 tint;
void main() {
    gl_Position = clip_from_enu * vec4(in_position, 1.0);
    enu_m = in_position;
    from_eye_m = in_position - eye_enu_m;
    uv = in_uv;
    tint = in_color;
}
"""

_SURFACE_FRAGMENT = """
#version 330 core
in vec3 enu_m; in vec3 from_eye_m; in vec2 uv; flat in vec4 tint;
uniform sampler2D picture;
uniform sampler3D grain;
uniform sampler2DShadow shadow;
uniform mat4 shadow_from_enu;
uniform mat3 grain_from_enu[2];
uniform vec3 to_sun_enu;
uniform float shadow_offset_m;
out vec4 out_color;
void main() {
    vec3 normal = normalize(cross(dFdx(from_eye_m), dFdy(from_eye_m)));
    if (dot(normal, from_eye_m) > 0.0) normal = -normal;
    vec3 albedo = tint.rgb * tint.rgb;
    #ifdef TEXTURED
    vec3 texel = texture(picture, uv).rgb;
    albedo *= texel * texel;
    #endif
    vec2 fine = texture(grain, grain_from_enu[0] * enu_m).rg - 0.5;
    vec2 coarse = texture(grain, grain_from_enu[1] * enu_m).rg - 0.5;
    vec2 stain = WEIGHT_0 * fine + WEIGHT_1 * coarse;
    albedo *= max(1.0 + tint.a * (GRAIN_LUMA * stain.x + stain.y * GRAIN_HUE), GRAIN_FLOOR);

    float facing = dot(normal, to_sun_enu);
    float lit = 0.0;
    if (facing > 0.0) {
        vec3 at = (shadow_from_enu * vec4(enu_m + normal * shadow_offset_m, 1.0)).xyz;
        lit = facing;
        if (all(greaterThan(at, vec3(0.0))) && all(lessThan(at, vec3(1.0)))) lit *= texture(shadow, at);
    }
    vec3 ambient = mix(GROUND_AMBIENT, SKY_AMBIENT, 0.5 + 0.5 * normal.z) * (1.0 - AMBIENT_TURN * facing);
    out_color = vec4(sqrt(1.0 - exp(-EXPOSURE * albedo * (SUN_COLOR * lit + ambient))), 1.0);
}
"""

SKY_VERTEX = """
#version 330 core
uniform mat3 enu_from_clip;
out vec3 direction;
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 1.0, 1.0);
    direction = enu_from_clip * vec3(corner, 1.0);
}
"""

_SKY_COLOR = """
uniform sampler2D sky;
vec3 sky_color(vec3 d) {
    float up = max(d.z, 0.0);
    vec2 at = 0.5 + 0.5 * SKY_SCALE * normalize(d.xy) * sqrt(1.0 - up * up) * inversesqrt(1.0 + up);
    return textureLod(sky, at, 0.0).rgb;
}
"""

_SKY_FRAGMENT = """
#version 330 core
in vec3 direction;
uniform sampler3D grain;
uniform vec3 eye_above_ground_m;
uniform vec3 land_irradiance;
out vec4 out_color;
""" + _SKY_COLOR + """
void main() {
    vec3 d = normalize(direction);
    vec3 color = sky_color(d);
    if (d.z < 0.0) {
        float range_m = max(eye_above_ground_m.z, 0.1) / max(-d.z, 1e-5);
        vec2 land_m = eye_above_ground_m.xy + d.xy * range_m;
        vec2 stain = LAND_GRAIN_0 * (texture(grain, vec3(land_m / LAND_PERIOD_0, 0.37)).rg - 0.5)
                   + LAND_GRAIN_1 * (texture(grain, vec3(land_m / LAND_PERIOD_1, 0.11)).rg - 0.5);
        vec3 albedo = LAND_COLOR * LAND_COLOR * max(1.0 + stain.x + stain.y * LAND_HUE, GRAIN_FLOOR);
        color = mix(color, sqrt(1.0 - exp(-EXPOSURE * albedo * land_irradiance)), exp(-range_m / HAZE_M));
    }
    out_color = vec4(color, 1.0);
}
"""

WATER_VERTEX = """
#version 330 core
in vec3 in_position;
uniform mat4 clip_from_enu;
uniform vec3 eye_enu_m;
out vec3 enu_m; out vec3 from_eye_m;
void main() {
    gl_Position = clip_from_enu * vec4(in_position, 1.0);
    enu_m = in_position;
    from_eye_m = in_position - eye_enu_m;
}
"""

_WATER_FRAGMENT = """
#version 330 core
in vec3 enu_m; in vec3 from_eye_m;
uniform sampler3D grain;
uniform vec3 drift[2];
uniform vec3 land_irradiance;
out vec4 out_color;
""" + _SKY_COLOR + """
void main() {
    vec2 slope = WAVE_SLOPE_0 * (texture(grain, drift[0] + vec3(enu_m.xy / WAVE_PERIOD_0, 0.0)).rg - 0.5)
               + WAVE_SLOPE_1 * (texture(grain, drift[1] + vec3(enu_m.xy / WAVE_PERIOD_1, 0.0)).rg - 0.5);
    vec3 normal = normalize(vec3(-slope, 1.0));
    vec3 d = normalize(from_eye_m);
    float mirrored = WATER_MIRROR + (1.0 - WATER_MIRROR) * pow(1.0 - clamp(-dot(d, normal), 0.0, 1.0), 5.0);
    vec3 out_of_it = sqrt(1.0 - exp(-EXPOSURE * WATER_COLOR * WATER_COLOR * land_irradiance));
    vec3 up = reflect(d, normal);
    out_color = vec4(mix(out_of_it, sky_color(vec3(up.xy, abs(up.z))), mirrored), 1.0);
}
"""

SHADOW_VERTEX = """
#version 330 core
in vec3 in_position;
uniform mat4 shadow_clip_from_enu;
void main() { gl_Position = shadow_clip_from_enu * vec4(in_position, 1.0); }
"""

SHADOW_FRAGMENT = """
#version 330 core
void main() {}
"""

AVERAGE_VERTEX = """
#version 330 core
out vec2 at;
void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    gl_Position = vec4(corner, 0.0, 1.0);
    at = 0.5 + 0.5 * corner;
}
"""

AVERAGE_FRAGMENT = """
#version 330 core
in vec2 at;
uniform sampler2D picture;
out vec4 out_color;
void main() { out_color = textureLod(picture, at, 0.0); }
"""


def surface_fragment(textured: bool) -> str:
    """Fragment shader of a surface, with or without a picture texture."""
    source = _with_constants(_SURFACE_FRAGMENT).lstrip()
    return source.replace("core\n", "core\n#define TEXTURED\n", 1) if textured else source


def sky_fragment() -> str:
    """Fragment shader of the sky."""
    return _with_constants(_SKY_FRAGMENT)


def water_fragment() -> str:
    """Fragment shader of water."""
    return _with_constants(_WATER_FRAGMENT)


def _with_constants(source: str) -> str:
    constants = {
        "GROUND_AMBIENT": _vec3(light.GROUND_AMBIENT), "SKY_AMBIENT": _vec3(light.SKY_AMBIENT),
        "SUN_COLOR": _vec3(light.SUN_COLOR), "LAND_COLOR": _vec3(light.LAND_COLOR),
        "LAND_HUE": _vec3(light.LAND_HUE), "EXPOSURE": f"{light.EXPOSURE:.6f}",
        "SKY_SCALE": f"{light.sky_map_scale():.8f}", "HAZE_M": f"{light.HAZE_M:.3f}",
        "GRAIN_HUE": _vec3(light.GRAIN_HUE), "GRAIN_LUMA": f"{light.GRAIN_LUMA:.6f}",
        "GRAIN_FLOOR": f"{light.GRAIN_FLOOR:.6f}", "AMBIENT_TURN": f"{light.AMBIENT_TURN:.6f}",
        "WATER_COLOR": _vec3(light.WATER_COLOR), "WATER_MIRROR": f"{light.WATER_MIRROR:.6f}",
        **{f"WAVE_PERIOD_{i}": f"{m:.3f}" for i, m in enumerate(light.WAVE_PERIODS_M)},
        **{f"WAVE_SLOPE_{i}": f"{s:.6f}" for i, s in enumerate(light.WAVE_SLOPES)},
        **{f"LAND_PERIOD_{i}": f"{m:.3f}" for i, m in enumerate(light.LAND_PERIODS_M)},
        **{f"LAND_GRAIN_{i}": f"{g:.6f}" for i, g in enumerate(light.LAND_GRAIN)},
        **{f"WEIGHT_{i}": f"{w:.6f}" for i, w in enumerate(light.GRAIN_WEIGHTS)},
    }
    for name, value in constants.items():
        source = source.replace(name, value)
    return source


def _vec3(color: tuple[float, float, float]) -> str:
    return "vec3({:.6f}, {:.6f}, {:.6f})".format(*color)
