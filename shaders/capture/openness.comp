// Adds what one far light sees of every vertex: cosine × share of a 4×4 patch of its depth map that does not lie before it.
layout(local_size_x = 64) in;
layout(std430, binding = 0) readonly buffer Vertices { vec4 in_vertex[]; };  // position, 1; normal, 0
layout(std430, binding = 1) buffer Sums { vec2 out_sum[]; };                 // visible, possible
layout(binding = 0) uniform sampler2D u_depth;

uniform mat4 u_clip_from_root;
uniform vec3 u_towards;  // unit, to the light
uniform float u_lift;    // metres along the normal
uniform float u_bias;    // of clip depth
uniform int u_count;

void main() {
    int v = int(gl_GlobalInvocationID.x);
    if (v >= u_count) return;
    vec3 normal = in_vertex[2 * v + 1].xyz;
    float cosine = dot(normal, u_towards);
    if (cosine <= 0.0) return;
    vec4 place = u_clip_from_root * vec4(in_vertex[2 * v].xyz + u_lift * normal, 1);
    ivec2 size = textureSize(u_depth, 0);
    vec2 pixel = (0.5 + 0.5 * place.xy) * vec2(size) - 0.5;
    ivec2 corner = ivec2(floor(pixel)) - 1;
    vec2 part = fract(pixel);
    float depth = 0.5 + 0.5 * place.z - u_bias, seen = 0.0;
    for (int y = 0; y < 4; ++y)
        for (int x = 0; x < 4; ++x) {
            ivec2 texel = corner + ivec2(x, y);
            bool outside = any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size));
            float weight = (x == 0 ? 1.0 - part.x : x == 3 ? part.x : 1.0) * (y == 0 ? 1.0 - part.y : y == 3 ? part.y : 1.0);
            if (outside || texelFetch(u_depth, texel, 0).x >= depth) seen += weight;
        }
    out_sum[v] += vec2(cosine * seen / 9.0, cosine);
}
