"""A renderer of one's own: the GPU picks the clusters of the cut, and one indirect draw shows them.

python examples/draw_clusters.py [mesh] [picture.png]    needs: pip install wgpu pillow
"""

import sys

import numpy as np
import wgpu
from PIL import Image

import nanite_rs as nrs

SIZE, FOV, PIXELS = 768, 0.8, 1.0
SHADER = """
struct Cluster { own: vec4f, group: vec4f, error: f32, group_error: f32, vertex: u32, triangle: u32, count: u32 }
struct View { matrix: mat4x4f, eye: vec3f, scale: f32 }
struct Draw { vertices: u32, instances: atomic<u32>, first_vertex: u32, first_instance: u32 }
@group(0) @binding(0) var<storage, read> clusters: array<Cluster>;
@group(0) @binding(1) var<storage, read> positions: array<f32>;
@group(0) @binding(2) var<storage, read> triangles: array<u32>;
@group(0) @binding(3) var<uniform> view: View;
@group(0) @binding(4) var<storage, read_write> visible: array<u32>;
@group(0) @binding(5) var<storage, read_write> draw: Draw;
@group(1) @binding(0) var<storage, read> drawn: array<u32>;

fn pixels(error: f32, sphere: vec4f) -> f32 {
    return error * view.scale / max(distance(view.eye, sphere.xyz) - sphere.w, 1e-6);
}
@compute @workgroup_size(64) fn pick(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&clusters) { return; }
    let c = clusters[id.x];
    if pixels(c.error, c.own) <= 1.0 && pixels(c.group_error, c.group) > 1.0 {
        visible[atomicAdd(&draw.instances, 1u)] = id.x;
    }
}
struct Corner { @builtin(position) at: vec4f, @interpolate(flat) @location(0) cluster: u32,
    @location(1) place: vec3f }
@vertex fn corner(@builtin(vertex_index) v: u32, @builtin(instance_index) i: u32) -> Corner {
    let c = clusters[drawn[i]];
    let t = triangles[c.triangle + min(v / 3u, c.count - 1u)];
    let p = 3u * (c.vertex + (t >> (8u * (v % 3u)) & 255u));
    let place = vec3f(positions[p], positions[p + 1u], positions[p + 2u]);
    return Corner(view.matrix * vec4f(place, 1.0), drawn[i], place);
}
@fragment fn shade(in: Corner) -> @location(0) vec4f {
    let n = normalize(cross(dpdx(in.place), dpdy(in.place)));
    let hue = vec3f(vec3u(in.cluster * 97u, in.cluster * 57u, in.cluster * 23u) % vec3u(128u)) / 255.0 + 0.5;
    return vec4f(hue * (0.3 + 0.7 * abs(dot(n, normalize(view.eye - in.place)))), 1.0);
}"""

path, picture = (sys.argv[1:] + ["", "clusters.png"][len(sys.argv) - 1 :])[:2]
shape = nrs.shapes.displaced_icosphere(faces=200_000)
mesh = nrs.NaniteMesh.from_file(path) if path else nrs.NaniteMesh.from_arrays(*shape)
every = mesh.clusters()
table = np.zeros((len(every), 16), np.float32)
table[:, 0:4], table[:, 4:8] = every.spheres, every.group_spheres[every.groups]
table[:, 8], table[:, 9] = every.errors, np.minimum(every.group_errors[every.groups], 1e30)
counts = [every.vertex_offsets[:-1], every.triangle_offsets[:-1], np.diff(every.triangle_offsets)]
table.view(np.uint32)[:, 10:13] = np.stack(counts, axis=1)
packed = every.triangles.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], np.uint32)

radius = np.linalg.norm(mesh.bounds[1] - mesh.bounds[0]) / 2
eye, centre = mesh.bounds.mean(axis=0) + radius * np.array([0.8, 0.6, 2.2]), mesh.bounds.mean(axis=0)
focal, near = 1 / np.tan(FOV / 2), 0.01 * radius
project = np.array([[focal, 0, 0, 0], [0, focal, 0, 0], [0, 0, 0, near], [0, 0, -1, 0]])
matrix = project @ np.linalg.inv(nrs.look_at(eye, centre))  # depth is reversed: 1 near, 0 far away
view = np.array([*matrix.T.ravel(), *eye, focal * SIZE / 2 / PIXELS], np.float32)

device = wgpu.gpu.request_adapter_sync().request_device_sync()
module, usage = device.create_shader_module(code=SHADER), wgpu.BufferUsage
arrays = [table, every.vertices.astype(np.float32), packed, view, np.zeros(len(every), np.uint32)]
arrays.append(np.array([384, 0, 0, 0], np.uint32))
uses = [usage.STORAGE] * 3 + [usage.UNIFORM, usage.STORAGE, usage.STORAGE | usage.INDIRECT | usage.COPY_SRC]
buffers = [device.create_buffer_with_data(data=a, usage=u) for a, u in zip(arrays, uses, strict=True)]
pick = device.create_compute_pipeline(layout="auto", compute={"module": module, "entry_point": "pick"})
kind, depth = wgpu.TextureFormat.rgba8unorm_srgb, wgpu.TextureFormat.depth32float
show = device.create_render_pipeline(
    layout="auto",
    vertex={"module": module, "entry_point": "corner"},
    fragment={"module": module, "entry_point": "shade", "targets": [{"format": kind}]},
    depth_stencil={"format": depth, "depth_write_enabled": True, "depth_compare": "greater"},
)


def bound(pipeline, group, **numbers):
    """Bind buffers to the bindings of a group."""
    entries = [{"binding": int(k[1:]), "resource": {"buffer": buffers[b]}} for k, b in numbers.items()]
    return device.create_bind_group(layout=pipeline.get_bind_group_layout(group), entries=entries)


use = wgpu.TextureUsage.RENDER_ATTACHMENT | wgpu.TextureUsage.COPY_SRC
image, depths = (device.create_texture(size=(SIZE, SIZE, 1), format=f, usage=use) for f in (kind, depth))
encoder = device.create_command_encoder()
work = encoder.begin_compute_pass()
work.set_pipeline(pick)
work.set_bind_group(0, bound(pick, 0, _0=0, _3=3, _4=4, _5=5))
work.dispatch_workgroups(-(-len(every) // 64))
work.end()
color = {"view": image.create_view(), "load_op": "clear", "store_op": "store", "clear_value": (1, 1, 1, 1)}
ground = {
    "view": depths.create_view(),
    "depth_load_op": "clear",
    "depth_store_op": "store",
    "depth_clear_value": 0,
}
work = encoder.begin_render_pass(color_attachments=[color], depth_stencil_attachment=ground)
work.set_pipeline(show)
work.set_bind_group(0, bound(show, 0, _0=0, _1=1, _2=2, _3=3))
work.set_bind_group(1, bound(show, 1, _0=4))
work.draw_indirect(buffers[5], 0)
work.end()
device.queue.submit([encoder.finish()])
layout = {"bytes_per_row": 4 * SIZE, "rows_per_image": SIZE}
pixels = device.queue.read_texture({"texture": image}, layout, (SIZE, SIZE, 1))
Image.fromarray(np.frombuffer(pixels, np.uint8).reshape(SIZE, SIZE, 4)).save(picture)
drawn = np.frombuffer(device.queue.read_buffer(buffers[5]), np.uint32)[1]
print(f"{drawn:,} of {len(every):,} clusters drawn; {picture}")
