//! Schemas that no wire type defines itself: bytes, and the names that a text may be.

use std::borrow::Cow;

use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, SchemaFormat, Type};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::code::Code;
use crate::formats::Format;
use crate::registry::Order;
use crate::relief::Layers;
use crate::service::OnExisting;
use crate::watermark::Method;

/// The bytes of a file. Client generators take `format: binary` for bytes, also in 3.1 documents;
/// most turn a bare `contentMediaType` into a text.
pub(super) fn bytes() -> Schema {
    let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
    ObjectBuilder::new().schema_type(Type::String).format(Some(format)).build().into()
}

/// A text that must be one of these names.
fn names(description: &str, names: impl Iterator<Item = &'static str>) -> RefOr<Schema> {
    let schema = ObjectBuilder::new()
        .schema_type(Type::String)
        .description(Some(description))
        .enum_values(Some(names));
    RefOr::T(schema.build().into())
}

macro_rules! names {
    ($($type:ident, $name:literal, $description:literal, $all:expr;)*) => {$(
        #[doc = $description]
        pub(super) struct $type;

        impl PartialSchema for $type {
            fn schema() -> RefOr<Schema> {
                names($description, $all)
            }
        }

        impl ToSchema for $type {
            fn name() -> Cow<'static, str> {
                Cow::Borrowed($name)
            }
        }
    )*};
}

names! {
    MethodName, "Method", "How a mark is embedded: which statistic of a bin is moved, and where on \
        its sphere a vertex goes.", Method::ALL.into_iter().map(Method::name);
    FormatName, "Format", "A file format.", Format::ALL.into_iter().map(Format::extension);
    OnExistingName, "OnExisting", "What to do when the file already carries a registered mark: \
        refuse it, mark it and name the marks found, or mark it and say nothing.",
        OnExisting::ALL.into_iter().map(OnExisting::name);
    LayersName, "Layers", "The layers of a mark: the blind one, which is read without the host; the relief, \
        which is read against the kept host, from a new tessellation or a fragment, too; or both.",
        Layers::ALL.into_iter().map(Layers::name);
    OrderName, "Order", "Which comes first: the last or the first registered.",
        Order::ALL.into_iter().map(Order::name);
    CodeName, "Code", "What went wrong. Codes are never renamed; later releases may have more.",
        Code::ALL.iter().map(|code| code.name());
}
