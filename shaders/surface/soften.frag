// A floor's light without the pattern of floor.frag, whose four neighbouring texels look in different directions: weights 1 2 1
// along both sides.
in vec2 v_uv;

uniform sampler2D u_light;

layout(location = 0) out vec2 out_light;

void main() {
    vec2 half_texel = 0.5 / vec2(textureSize(u_light, 0));
    vec2 sum = vec2(0);
    for (int k = 0; k < 4; ++k)
        sum += textureLod(u_light, v_uv + half_texel * vec2((k & 1) * 2 - 1, (k >> 1) * 2 - 1), 0).xy;
    out_light = 0.25 * sum;
}
