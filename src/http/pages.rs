//! Lists in pages: the requested part of a list, and the address of the next one.
//!
//! Without `limit`, these lists are returned whole, as they have always been; only `GET
//! /v1/sessions` has pages by default.

use axum::http::header::LINK;
use axum::http::{HeaderMap, HeaderValue};

use crate::http::problem::Problem;
use crate::http::request::{Parameters, ReadQuery};

/// The largest number of items on a page.
const LARGEST_PAGE: u32 = 1000;

/// Which part of a list is asked for.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct PageParameters {
    /// How many, 1 to 1000; default: all.
    #[param(minimum = 1, maximum = 1000)]
    pub(super) limit: Option<u32>,
    /// Id of the last item of the previous page, from its `Link` header.
    pub(super) cursor: Option<String>,
}

/// How every list that comes in pages refuses a part that is not there.
#[derive(utoipa::IntoResponses)]
#[expect(dead_code, reason = "describes what `PageParameters` answers")]
pub(super) enum PageRefusals {
    /// an invalid limit
    #[response(status = 422, content_type = "application/problem+json")]
    Part(Problem),
}

impl ReadQuery for PageParameters {
    fn read(parameters: &Parameters) -> Result<Self, Problem> {
        let cursor = parameters.text("cursor").map(str::to_owned);
        Ok(Self { limit: page_limit(parameters)?, cursor })
    }
}

/// The query's `limit`.
pub(super) fn page_limit(parameters: &Parameters) -> Result<Option<u32>, Problem> {
    match parameters.count("limit")? {
        Some(limit) if limit > LARGEST_PAGE => {
            Err(Problem::field("limit", &format!("`{limit}` is more than {LARGEST_PAGE}")))
        }
        limit => Ok(limit),
    }
}

impl PageParameters {
    /// The requested part of `all`, and the header with the address of the next one; `path` is the
    /// list's address, and `id_of` gives an item's cursor.
    ///
    /// # Errors
    /// 404 for a cursor that is not in the list.
    pub(super) fn of<T>(
        &self,
        path: &str,
        mut all: Vec<T>,
        id_of: impl Fn(&T) -> String,
    ) -> Result<(Vec<T>, HeaderMap), Problem> {
        if let Some(cursor) = &self.cursor {
            let at = all.iter().position(|item| id_of(item) == *cursor);
            let unknown = || {
                Problem::not_found(format!(
                    "cursor `{cursor}` is not in this list; start again without a cursor"
                ))
            };
            all.drain(..=at.ok_or_else(unknown)?);
        }
        let limit = self.limit.map_or(usize::MAX, |limit| limit as usize);
        let has_more = limit < all.len();
        all.truncate(limit);
        let last = all.last().filter(|_| has_more).map(&id_of);
        let headers = self.to_next(path, last.as_deref());
        Ok((all, headers))
    }

    /// The header with the address of the page after `last`, where there is one.
    pub(super) fn to_next(&self, path: &str, last: Option<&str>) -> HeaderMap {
        let next = self.limit.zip(last).map(|(limit, last)| {
            // The matched part of an address, and identifiers, need no escaping.
            format!("<{path}?limit={limit}&cursor={last}>; rel=\"next\"")
        });
        let next = next.and_then(|next| HeaderValue::from_str(&next).ok());
        next.map(|next| (LINK, next)).into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pages_of_a_list_are_the_list() {
        let all: Vec<u32> = (0..23).collect();
        for limit in [1, 5, 22, 23, 1000] {
            let (mut found, mut cursor) = (Vec::new(), None);
            loop {
                let asked = PageParameters { limit: Some(limit), cursor };
                let (page, headers) = asked.of("/v1/n", all.clone(), u32::to_string).unwrap();
                assert!(page.len() <= limit as usize);
                found.extend(page);
                let Some(link) = headers.get(LINK) else { break };
                let last = found.last().unwrap();
                let expected = format!("</v1/n?limit={limit}&cursor={last}>; rel=\"next\"");
                assert_eq!(link.to_str().unwrap(), expected);
                cursor = Some(last.to_string());
            }
            assert_eq!(found, all);
        }
        let whole = PageParameters { limit: None, cursor: None };
        assert_eq!(whole.of("/v1/n", all.clone(), u32::to_string).unwrap().0, all);
        let unknown = PageParameters { limit: None, cursor: Some("99".into()) };
        assert_eq!(unknown.of("/v1/n", all, u32::to_string).unwrap_err().status(), 404);
    }
}
