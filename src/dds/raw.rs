//! Messages as they are on the wire: the four bytes that state the encoding, and the content.

use std::convert::Infallible;

use rustdds::RepresentationIdentifier;
use rustdds::bytes::Bytes;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};

/// A message of any type, its encoding in front.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RawMessage(pub Vec<u8>);

/// Neither reads nor changes what is in a message.
#[derive(Debug, Clone, Copy)]
pub struct AsItIs;

/// The bytes that state an encoding.
pub(super) const HEAD: usize = 4;

impl<'de> Decode<'de, RawMessage> for AsItIs {
    type Error = Infallible;

    fn decode_bytes(
        self,
        content: &'de [u8],
        encoding: RepresentationIdentifier,
    ) -> Result<RawMessage, Infallible> {
        let mut bytes = Vec::with_capacity(HEAD + content.len());
        bytes.extend(encoding.to_bytes());
        bytes.resize(HEAD, 0);
        bytes.extend_from_slice(content);
        Ok(RawMessage(bytes))
    }
}

impl DeserializerAdapter<RawMessage> for AsItIs {
    type Error = Infallible;
    type Decoded = RawMessage;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: RawMessage) -> RawMessage {
        decoded
    }
}

impl DefaultDecoder<RawMessage> for AsItIs {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl SerializerAdapter<RawMessage> for AsItIs {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(message: &RawMessage) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(message.0.get(HEAD..).unwrap_or_default()))
    }
}
