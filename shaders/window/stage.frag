// The exact picture faded in over the surface, both over the floor and the background of a stage, as avatarrex/stage/composite.py
// has it. Reads premultiplied sRGB-encoded colours and maps of the floor's light; writes straight alpha. World frame, metres.
// PICTURES, MAPS: 1 the surface's, 2 the exact one, 3 both; MAPS 0 none. HAS_FLOOR. BACKDROP: 0 a colour, 1 a gradient, 2 a picture.
// Software renderers take both sides of an `if`, so that each of these is a program.

uniform float u_weight;         // share of the exact picture, 0 to 1
#if PICTURES & 1
uniform sampler2D u_surface;
#endif
#if PICTURES & 2
uniform sampler2D u_exact;
#endif
#if BACKDROP == 0
uniform vec4 u_background;      // premultiplied
#elif BACKDROP == 1
uniform vec3 u_top, u_bottom;
#else
uniform sampler2D u_picture;
uniform vec2 u_part;            // of the picture that is seen, about its middle
uniform float u_picture_level;  // of its mipmaps
#endif
uniform float u_gain;
#if HAS_FLOOR
uniform mat3 u_ray_from_uv;     // of a place (u, v, 1) of the raster
uniform vec3 u_eye;
uniform float u_height;         // of the floor
uniform float u_shadow;         // how dark a shadow is
uniform vec3 u_pool;            // x and z of the figure, and how much brighter the floor is there
#endif
#if MAPS & 1
uniform sampler2D u_surface_floor;
uniform vec4 u_surface_region;  // least x and z, greatest x and z
#endif
#if MAPS & 2
uniform sampler2D u_exact_floor;
uniform vec4 u_exact_region;
#endif

in vec2 v_uv;
out vec4 out_colour;

#if HAS_FLOOR
float brightness(sampler2D map, vec4 region, vec2 place) {
    vec2 border = min(place - region.xy, region.zw - place);
    vec2 light = textureLod(map, (place - region.xy) / (region.zw - region.xy), 0).xy;
    return 1 - clamp(min(border.x, border.y) / FADE, 0.0, 1.0) * (1 - dot(light, vec2(KEY, SKY)));
}

float brightness_at(vec2 place) {
#if MAPS == 3
    return mix(brightness(u_surface_floor, u_surface_region, place), brightness(u_exact_floor, u_exact_region, place), u_weight);
#elif MAPS == 1
    return brightness(u_surface_floor, u_surface_region, place);
#elif MAPS == 2
    return brightness(u_exact_floor, u_exact_region, place);
#else
    return 1;
#endif
}

vec4 on_floor(vec4 behind) {
    vec3 ray = u_ray_from_uv * vec3(v_uv, 1);
    float above = u_eye.y - u_height;
    if (ray.y >= 0 || above <= 0) return behind;
    vec2 place = u_eye.xz - above / ray.y * ray.xz, away = place - u_pool.xy;
    float near = max(1 - dot(away, away) / (POOL_RADIUS * POOL_RADIUS), 0.0);
    float shade = 1 - u_shadow * (1 - brightness_at(place));
    return vec4(min(behind.rgb * (1 + u_pool.z * near * near), behind.aaa) * shade, 1 - (1 - behind.a) * shade);
}
#endif

void main() {
#if PICTURES == 3
    vec4 colour = mix(texture(u_surface, v_uv), texture(u_exact, v_uv), u_weight);
#elif PICTURES == 1
    vec4 colour = texture(u_surface, v_uv);
#else
    vec4 colour = texture(u_exact, v_uv);
#endif
#if BACKDROP == 0
    vec4 behind = u_background;
#elif BACKDROP == 1
    vec4 behind = vec4(mix(u_top, u_bottom, v_uv.y), 1);
#else
    vec4 behind = vec4(textureLod(u_picture, 0.5 + (v_uv - 0.5) * u_part, u_picture_level).rgb, 1);
#endif
#if HAS_FLOOR
    behind = on_floor(behind);
#endif
    colour += (1.0 - colour.a) * behind;
    out_colour = vec4(min(u_gain * colour.rgb / max(colour.a, 1e-6), 1.0), colour.a);
}
