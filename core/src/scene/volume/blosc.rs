//! Blocks that were compressed by Blosc with LZ4, as OpenVDB and NanoVDB do (formats of c-blosc 1, `README_CHUNK_FORMAT.rst`, and of LZ4's
//! blocks, `lz4_Block_format.md`).

/// Bytes of a chunk's header.
const HEADER: usize = 16;
const SHUFFLED: u8 = 1;
const COPIED: u8 = 2;
const BIT_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 16;
/// The code of LZ4 among compressors.
const LZ4: u8 = 1;
/// Larger types are not split, nor are blocks with fewer bytes of each significance.
const LARGEST_SPLIT: usize = 16;
const SMALLEST_SPLIT: usize = 128;
/// OpenVDB compresses this many zeros after what is short.
const PADDING: usize = 128;

/// The first `expected` bytes of a chunk, which may hold a few more.
pub(super) fn decompress(chunk: &[u8], expected: usize) -> Result<Vec<u8>, &'static str> {
    let header = chunk.get(..HEADER).ok_or("its header is cut off")?;
    let (flags, type_size) = (header[2], usize::from(header[3]));
    let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|byte| header[at + byte])) as usize;
    let (bytes, block) = (word(4), word(8));
    if bytes < expected || bytes > expected.saturating_add(PADDING) {
        return Err("it holds another number of bytes than expected");
    }
    if flags & COPIED != 0 {
        let copied = chunk.get(HEADER..HEADER + expected).ok_or("it is cut off")?;
        return Ok(copied.to_vec());
    }
    if flags & BIT_SHUFFLED != 0 || flags >> 5 != LZ4 {
        return Err("it was compressed by another method than LZ4");
    }
    if block == 0 || type_size == 0 {
        return Err("its header is broken");
    }
    let mut out = Vec::new();
    out.try_reserve_exact(bytes)
        .map_err(|_| "memory does not hold its content")?;
    for (number, first) in (0..bytes).step_by(block).enumerate() {
        let length = block.min(bytes - first);
        let whole = length == block;
        let split =
            flags & NOT_SPLIT == 0 && type_size <= LARGEST_SPLIT && block / type_size >= SMALLEST_SPLIT && whole;
        let parts = if split { type_size } else { 1 };
        if !length.is_multiple_of(parts) {
            return Err("a block of it cannot be split");
        }
        let mut at = read_word(chunk, HEADER + 4 * number)?;
        for _ in 0..parts {
            let packed = read_word(chunk, at)?;
            at = at.saturating_add(4);
            let end = at.saturating_add(packed);
            let part = chunk.get(at..end).ok_or("it is cut off")?;
            at = end;
            match packed == length / parts {
                true => out.extend_from_slice(part),
                false => unpack_lz4(part, length / parts, &mut out)?,
            }
        }
        if flags & SHUFFLED != 0 && type_size > 1 {
            unshuffle(&mut out[first..], type_size);
        }
    }
    out.truncate(expected);
    Ok(out)
}

fn read_word(bytes: &[u8], at: usize) -> Result<usize, &'static str> {
    let word = bytes.get(at..at.saturating_add(4)).ok_or("it is cut off")?;
    Ok(u32::from_le_bytes(std::array::from_fn(|byte| word[byte])) as usize)
}

/// Puts together the bytes of each value, of which all first ones come first.
fn unshuffle(bytes: &mut [u8], type_size: usize) {
    let count = bytes.len() / type_size;
    let shuffled = bytes.to_vec();
    for (index, value) in bytes.chunks_exact_mut(type_size).enumerate() {
        for (significance, byte) in value.iter_mut().enumerate() {
            *byte = shuffled[significance * count + index];
        }
    }
}

/// Appends the `length` bytes of a block of LZ4.
fn unpack_lz4(packed: &[u8], length: usize, out: &mut Vec<u8>) -> Result<(), &'static str> {
    const CUT: &str = "a block of LZ4 is cut off";
    let (start, mut at) = (out.len(), 0);
    let byte = |at: &mut usize| {
        let byte = packed.get(*at).copied().ok_or(CUT)?;
        *at += 1;
        Ok::<_, &'static str>(usize::from(byte))
    };
    // A length of 15 goes on in bytes that are added, until one is not 255.
    let long = |at: &mut usize, short: usize| {
        let mut sum = short;
        if short == 15 {
            loop {
                let more = byte(at)?;
                sum += more;
                if more < 255 {
                    break;
                }
            }
        }
        Ok::<_, &'static str>(sum)
    };
    loop {
        let token = byte(&mut at)?;
        let literals = long(&mut at, token >> 4)?;
        let end = at.saturating_add(literals);
        let copied = packed.get(at..end).ok_or(CUT)?;
        if out.len() - start + literals > length {
            return Err("a block of LZ4 holds too much");
        }
        out.extend_from_slice(copied);
        at = end;
        if at == packed.len() {
            break;
        }
        let offset = byte(&mut at)? | byte(&mut at)? << 8;
        let matched = long(&mut at, token & 15)? + 4;
        if offset == 0 || offset > out.len() - start {
            return Err("a block of LZ4 refers to what comes before it");
        }
        if out.len() - start + matched > length {
            return Err("a block of LZ4 holds too much");
        }
        for _ in 0..matched {
            out.push(out[out.len() - offset]);
        }
    }
    match out.len() - start == length {
        true => Ok(()),
        false => Err("a block of LZ4 holds too little"),
    }
}
