//! The registered LZ4 filter (32004): raw size (u64) and block size (u32), both big-endian, then each
//! block's stored size (u32, big-endian) and content. A block whose stored size is its raw size is not
//! compressed.

/// Raw bytes of a block; the whole chunk where it is smaller.
const BLOCK_BYTES: usize = 1 << 30;

/// Length of the two sizes at the front.
const HEADER_BYTES: usize = 12;

/// Encodes a chunk.
pub(super) fn encode(raw: &[u8]) -> Vec<u8> {
    let block_bytes = raw.len().clamp(1, BLOCK_BYTES);
    let mut stored = Vec::with_capacity(HEADER_BYTES + raw.len() / 2);
    stored.extend_from_slice(&(raw.len() as u64).to_be_bytes());
    stored.extend_from_slice(&(block_bytes as u32).to_be_bytes());
    for block in raw.chunks(block_bytes) {
        let compressed = lz4_flex::block::compress(block);
        let content = if compressed.len() < block.len() { &compressed[..] } else { block };
        stored.extend_from_slice(&(content.len() as u32).to_be_bytes());
        stored.extend_from_slice(content);
    }
    stored
}

/// Decodes a chunk of `chunk_bytes` bytes.
pub(super) fn decode(stored: &[u8], chunk_bytes: usize) -> Result<Vec<u8>, String> {
    let short = || "LZ4: the chunk ends early".to_owned();
    let (header, mut rest) = stored.split_at_checked(HEADER_BYTES).ok_or_else(short)?;
    let raw_bytes = u64::from_be_bytes(header[..8].try_into().expect("eight of twelve bytes"));
    let block_bytes = u32::from_be_bytes(header[8..].try_into().expect("the last four of twelve"));
    if raw_bytes != chunk_bytes as u64 || block_bytes == 0 {
        return Err(format!("LZ4: claims {raw_bytes} bytes in blocks of {block_bytes}"));
    }
    let mut raw = vec![0; chunk_bytes];
    for block in raw.chunks_mut(block_bytes as usize) {
        let (size, after) = rest.split_first_chunk::<4>().ok_or_else(short)?;
        let size = u32::from_be_bytes(*size) as usize;
        let (content, after) = after.split_at_checked(size).ok_or_else(short)?;
        if size == block.len() {
            block.copy_from_slice(content);
        } else {
            let expected = block.len();
            match lz4_flex::block::decompress_into(content, block) {
                Ok(found) if found == expected => {}
                Ok(found) => {
                    return Err(format!("LZ4: a block holds {found}, not {expected} bytes"));
                }
                Err(error) => return Err(format!("LZ4: {error}")),
            }
        }
        rest = after;
    }
    Ok(raw)
}
