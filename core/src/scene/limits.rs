//! How large a scene may be.

/// Limits of a scene; each is checked before memory is taken for what it bounds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one file.
    pub file_bytes: u64,
    /// Bytes of all files together.
    pub total_bytes: u64,
    /// Files.
    pub files: u64,
    /// Bytes of XML, each reading of a file and each filled-in parameter counted.
    pub xml_bytes: u64,
    /// XML nodes (elements and texts) of one file.
    pub xml_nodes: u32,
    /// Nesting depth of XML elements, of included files, and of objects within objects.
    pub depth: u32,
    /// Included files, each inclusion counted.
    pub includes: u64,
    /// Attributes of one XML element.
    pub attributes: u64,
    /// Bytes of an attribute's value after parameters are filled in.
    pub attribute_bytes: u64,
    /// Shapes.
    pub shapes: u64,
    /// Triangles of all shapes together.
    pub triangles: u64,
    /// Vertices of all meshes together.
    pub vertices: u64,
    /// Bytes of mesh files, each reading counted.
    pub mesh_bytes: u64,
    /// Texels of one image.
    pub image_texels: u64,
    /// Texels of all images together.
    pub texels: u64,
    /// Bytes of textures in memory. Those that would go beyond lie in a temporary file, from which parts are read when they are looked up.
    pub texture_bytes: u64,
    /// Pixels of the film.
    pub pixels: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file_bytes: 1 << 30,
            total_bytes: 4 << 30,
            files: 10_000,
            xml_bytes: 64 << 20,
            xml_nodes: 2_000_000,
            depth: 64,
            includes: 1000,
            attributes: 32,
            attribute_bytes: 1 << 18,
            shapes: 100_000,
            triangles: 20_000_000,
            vertices: 40_000_000,
            mesh_bytes: 8 << 30,
            image_texels: 1 << 28,
            texels: 1 << 32,
            texture_bytes: 1 << 30,
            pixels: 1 << 26,
        }
    }
}
