"""GLB files: reading, writing, and adding meshes that shine."""

import json
import struct

import numpy

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
LIGHTS = "KHR_lights_punctual"
EMISSIVE, SPECULAR = "KHR_materials_emissive_strength", "KHR_materials_specular"


class Glb:
    """A glTF document with its binary chunk."""

    def __init__(self, data):
        self.document, self.binary = {}, bytearray()
        at = 12
        while at < len(data):
            size, kind = struct.unpack_from("<2I", data, at)
            chunk = data[at + 8 : at + 8 + size]
            if kind == JSON_CHUNK:
                self.document = json.loads(chunk)
            elif kind == BINARY_CHUNK:
                self.binary = bytearray(chunk)
            at += 8 + size

    def bytes(self):
        """The file."""
        text = json.dumps(self.document, separators=(",", ":"), sort_keys=True).encode()
        text += b" " * (-len(text) % 4)
        self.binary += b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<2I", len(text), JSON_CHUNK) + text
        if self.binary:
            chunks += struct.pack("<2I", len(self.binary), BINARY_CHUNK) + self.binary
        return struct.pack("<3I", 0x46546C67, 2, 12 + len(chunks)) + chunks

    def uses(self, extension):
        """Says that the file uses an extension."""
        used = self.document.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)

    def _append(self, key, thing):
        self.document.setdefault(key, []).append(thing)
        return len(self.document[key]) - 1

    def _accessor(self, array, kind, component):
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = self._append(
            "bufferViews", {"buffer": 0, "byteOffset": len(self.binary), "byteLength": array.nbytes}
        )
        self.binary += array.tobytes()
        accessor = {"bufferView": view, "componentType": component, "count": len(array), "type": kind}
        if kind == "VEC3":
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return self._append("accessors", accessor)

    def emission(self, name, radiance, texture=None):
        """A black material that shines with a radiance (red, green, blue), times a texture."""
        strength = max(*radiance, 0.0)
        factor = [value / strength if strength else 0.0 for value in radiance]
        self.uses(EMISSIVE)
        self.uses(SPECULAR)
        material = {
            "name": name,
            "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0, "roughnessFactor": 1},
            "emissiveFactor": factor,
            "extensions": {EMISSIVE: {"emissiveStrength": strength}, SPECULAR: {"specularFactor": 0}},
        }
        if texture is not None:
            material["emissiveTexture"] = {"index": texture}
        return self._append("materials", material)

    def add_texture(self, name, data):
        """Adds an image of any kind that Photonfarm reads, as a texture that repeats."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = self._append("bufferViews", {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data
        return self._append("textures", {"source": self._append("images", {"name": name, "bufferView": view})})

    def remove_lights(self, names):
        """Takes the lights with these names from their nodes."""
        lights = self.document.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
        for node in self.document.get("nodes", []):
            index = node.get("extensions", {}).get(LIGHTS, {}).get("light")
            if index is not None and lights[index].get("name") in names:
                del node["extensions"][LIGHTS]

    def add_mesh(self, name, parts):
        """Adds a node with a mesh in glTF's world, of parts: positions (n x 3), triangles (m x 3), a material, and for one with a texture
        coordinates in it (n x 2)."""
        primitives = []
        for positions, triangles, material, *coordinates in parts:
            positions = numpy.ascontiguousarray(positions, dtype="<f4")
            indices = numpy.ascontiguousarray(triangles, dtype="<u4").ravel()
            attributes = {"POSITION": self._accessor(positions, "VEC3", 5126)}
            for uv in coordinates:
                attributes["TEXCOORD_0"] = self._accessor(numpy.ascontiguousarray(uv, dtype="<f4"), "VEC2", 5126)
            primitives.append({"attributes": attributes, "indices": self._accessor(indices, "SCALAR", 5125), "material": material})
        mesh = self._append("meshes", {"name": name, "primitives": primitives})
        node = self._append("nodes", {"name": name, "mesh": mesh})
        scenes = self.document.setdefault("scenes", [{"nodes": []}])
        scenes[self.document.get("scene", 0)].setdefault("nodes", []).append(node)
        buffers = self.document.setdefault("buffers", [{}])
        buffers[0]["byteLength"] = len(self.binary) + -len(self.binary) % 4
