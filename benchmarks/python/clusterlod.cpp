// Builds a mesh with meshoptimizer's clusterlod.h and writes its clusters: a peer of `python -m benchmarks.python.dilation`.
//
// clusterlod INPUT OUTPUT DILATE
// INPUT: counts of vertices and indices (u32), positions (3 f32 each), indices (u32).
// OUTPUT: seconds of the build (f64); for each cluster: its group and the group it was made of (i32, -1 for none), errors of
// both (f32), how many triangles (u32), and 9 f32 for each of these.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "meshoptimizer.h"

#define CLUSTERLOD_IMPLEMENTATION
#include "clusterlod.h"

namespace
{
struct Output
{
	const std::vector<float>* positions;
	std::vector<float> errors;
	std::vector<char> bytes;

	template <typename T> void put(const T& value)
	{
		const char* data = reinterpret_cast<const char*>(&value);
		bytes.insert(bytes.end(), data, data + sizeof(T));
	}
};

// Positions are copied as they are now: dilated borders move them later.
int output(void* context, clodGroup group, const clodCluster* clusters, size_t count)
{
	Output& out = *static_cast<Output*>(context);
	int id = int(out.errors.size());
	out.errors.push_back(group.simplified.error);
	for (size_t k = 0; k < count; ++k)
	{
		out.put(int32_t(id));
		out.put(int32_t(clusters[k].refined));
		out.put(group.simplified.error);
		out.put(clusters[k].refined < 0 ? -1.f : out.errors[clusters[k].refined]);
		out.put(uint32_t(clusters[k].index_count / 3));
		for (size_t i = 0; i < clusters[k].index_count; ++i)
			for (int axis = 0; axis < 3; ++axis)
				out.put((*out.positions)[clusters[k].indices[i] * 3 + axis]);
	}
	return id;
}

void check(bool fine, const char* what)
{
	if (!fine)
		std::perror(what), std::exit(1);
}
} // namespace

int main(int argc, char** argv)
{
	check(argc == 4, "clusterlod INPUT OUTPUT DILATE");
	std::FILE* file = std::fopen(argv[1], "rb");
	check(file, argv[1]);
	uint32_t counts[2];
	check(std::fread(counts, sizeof(counts), 1, file) == 1, argv[1]);
	std::vector<float> positions(counts[0] * 3);
	std::vector<unsigned int> indices(counts[1]);
	check(std::fread(positions.data(), 4, positions.size(), file) == positions.size(), argv[1]);
	check(std::fread(indices.data(), 4, indices.size(), file) == indices.size(), argv[1]);
	std::fclose(file);

	clodConfig config = clodDefaultConfig(128);
	config.simplify_dilate_borders = std::atoi(argv[3]) != 0;
	clodMesh mesh = {};
	mesh.indices = indices.data(), mesh.index_count = indices.size();
	mesh.vertex_positions = positions.data(), mesh.vertex_positions_stride = 12, mesh.vertex_count = counts[0];
	Output out = {&positions, {}, {}};
	auto start = std::chrono::steady_clock::now();
	clodBuild(config, mesh, &out, output);
	double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();

	file = std::fopen(argv[2], "wb");
	check(file, argv[2]);
	check(std::fwrite(&seconds, sizeof(seconds), 1, file) == 1, argv[2]);
	check(std::fwrite(out.bytes.data(), 1, out.bytes.size(), file) == out.bytes.size(), argv[2]);
	return std::fclose(file);
}
