// Whether the texture unit interpolates in float: reads a ramp of two texels (0, 1) at 64 places. Writes what it got.
layout(local_size_x = 64) in;
#include "lib/trilinear.glsl"
uniform sampler3D u_body;
layout(std430, binding = 0) writeonly buffer Values { float out_value[]; };

void main() {
    uint k = gl_LocalInvocationIndex;
    out_value[k] = trilinear_filtered(u_body, vec3(k / 63.0, 0, 0)).x;
}
