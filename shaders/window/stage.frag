// The exact picture faded in over the surface, both over the floor and the background of a stage, as avatarrex/stage/composite.py
// has it. Reads premultiplied sRGB-encoded colours and maps of the floor's light; writes straight alpha. World frame, metres.

uniform sampler2D u_surface;
uniform sampler2D u_exact;
uniform float u_weight;         // share of the exact picture, 0 to 1
uniform int u_backdrop;         // 0 a colour, 1 a gradient, 2 a picture
uniform vec4 u_background;      // the colour, premultiplied
uniform vec3 u_top, u_bottom;   // the gradient
uniform sampler2D u_picture;
uniform vec2 u_part;            // of the picture that is seen, about its middle
uniform float u_gain;
uniform bool u_has_floor;
uniform mat3 u_ray_from_uv;     // of a place (u, v, 1) of the raster
uniform vec3 u_eye;
uniform float u_height;         // of the floor
uniform float u_shadow;         // how dark a shadow is
uniform vec3 u_pool;            // x and z of the figure, and how much brighter the floor is there
uniform sampler2D u_surface_floor;
uniform sampler2D u_exact_floor;
uniform float u_floor_weight;   // of the exact picture's map
uniform vec4 u_surface_region;  // least x and z, greatest x and z; empty where there is no map
uniform vec4 u_exact_region;

in vec2 v_uv;
out vec4 out_colour;

float brightness(sampler2D map, vec4 region, vec2 place) {
    if (region.x >= region.z) return 1.0;
    vec2 light = textureLod(map, (place - region.xy) / (region.zw - region.xy), 0).xy;
    vec2 border = min(place - region.xy, region.zw - place);
    return 1 - clamp(min(border.x, border.y) / FADE, 0.0, 1.0) * (1 - dot(light, vec2(KEY, SKY)));
}

vec4 on_floor(vec4 behind) {
    vec3 ray = u_ray_from_uv * vec3(v_uv, 1);
    float above = u_eye.y - u_height;
    if (ray.y >= 0 || above <= 0) return behind;
    vec2 place = (u_eye + above / -ray.y * ray).xz, away = place - u_pool.xy;
    float gain = 1 + u_pool.z * exp(-dot(away, away) / (POOL_RADIUS * POOL_RADIUS));
    float light = mix(brightness(u_surface_floor, u_surface_region, place),
                      brightness(u_exact_floor, u_exact_region, place), u_floor_weight);
    float shade = 1 - u_shadow * (1 - light);
    return vec4(min(behind.rgb * gain, behind.aaa) * shade, 1 - (1 - behind.a) * shade);
}

void main() {
    vec4 behind = u_background;
    if (u_backdrop == 1) behind = vec4(mix(u_top, u_bottom, v_uv.y), 1);
    if (u_backdrop == 2) behind = vec4(texture(u_picture, 0.5 + (v_uv - 0.5) * u_part).rgb, 1);
    if (u_has_floor) behind = on_floor(behind);
    vec4 colour = mix(texture(u_surface, v_uv), texture(u_exact, v_uv), u_weight);
    colour += (1.0 - colour.a) * behind;
    out_colour = vec4(min(u_gain * colour.rgb / max(colour.a, 1e-6), 1.0), colour.a);
}
